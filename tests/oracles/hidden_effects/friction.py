"""Friction states: of an approach by its rule, or of a motion by following the slip at every station.

The rule: a quarter turn of a pair loads it fully (phi = +-1), a decreasing oscillation releases it (phi = 0); a
translation of the pair after that leaves exp(-|dl| / release). Following the slip: phi grows with the circumferential
slip r_out dtheta_in - r_in dtheta_out over a breakaway length until the Coulomb limit (Dahl's model without hardening).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden_effects.equilibrium import FrictionState, State, System
from hidden_effects.tube import Array

BREAKAWAY_M = 0.02e-3


@dataclass
class SlipHistory:
    """phi at the stations of every pair before a step, and the twist of the pairs there; a FrictionState."""

    phi: list[Array]
    slip: list[Array]
    breakaway_m: float = BREAKAWAY_M

    @staticmethod
    def begin(system: System, state: State, phi: Array) -> SlipHistory:
        """From a state that is loaded by phi (n - 1,) all along."""
        phis = [np.full(len(c.s), p) for c, p in zip(system.contacts, phi.tolist(), strict=True)]
        return SlipHistory(phis, [twist_of(system, state, k) for k in range(len(phis))])

    def __call__(self, system: System, state: State, k: int) -> tuple[Array, Array]:
        trial = self.phi[k] + (twist_of(system, state, k) - self.slip[k]) / self.breakaway_m
        outer, inner = system.contacts[k].twist
        rods = system.rods[k], system.rods[k + 1]
        rows = np.concatenate(
            [np.zeros((len(trial), rods[0].n_bend)), -outer, np.zeros((len(trial), rods[1].n_bend)), -inner], axis=1
        )
        return np.clip(trial, -1, 1), rows / self.breakaway_m * (np.abs(trial) < 1)[:, None]

    def scaled(self, share: float) -> FrictionState:
        """As with so much of the friction coefficients."""

        def state_of(system: System, state: State, k: int) -> tuple[Array, Array]:
            phi, slope = self(system, state, k)
            return share * phi, share * slope

        return state_of

    def after(self, system: System, state: State) -> SlipHistory:
        """The history once `state` was reached."""
        phis = [self(system, state, k)[0] for k in range(len(self.phi))]
        return SlipHistory(phis, [twist_of(system, state, k) for k in range(len(phis))], self.breakaway_m)


def twist_of(system: System, state: State, k: int) -> Array:
    """Circumferential position of the inner tube on the outer one at the stations of pair k [m]."""
    outer, inner = system.contacts[k].twist
    return np.asarray(-outer @ system.parts(state.x, k)[1] - inner @ system.parts(state.x, k + 1)[1])


def remaining(phi: Array, translation_m: Array, release_m: float) -> Array:
    """phi (n - 1,) after the pairs have translated by `translation_m` (n - 1,)."""
    return np.asarray(phi * np.exp(-np.abs(translation_m) / release_m))
