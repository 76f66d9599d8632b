"""Friction states: of an approach by its rule, or of a motion by following the slip at every station.

The rule: a quarter turn of a pair loads it fully (phi = +-1), a decreasing oscillation releases it (phi = 0); a
translation of the pair after that leaves exp(-|dl| / release). Following the slip: Coulomb friction opposes it, so
phi has an axial companion psi. Both grow with the slip, r_out dtheta_in - r_in dtheta_out and the relative translation,
over a breakaway length, and are drawn back to the unit disc (Dahl's model without hardening): a pair that slides along
as fast as it turns keeps little of phi.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden_effects.equilibrium import FrictionState, State, System
from hidden_effects.tube import Array

BREAKAWAY_M = 0.02e-3


@dataclass
class SlipHistory:
    """(phi, psi) at the stations of every pair before a step, and the twist of the pairs there; a FrictionState."""

    phi: list[Array]
    slip: list[Array]
    psi: list[Array]
    l_b: Array  # (n,) translations of the collars there
    breakaway_m: float = BREAKAWAY_M

    @staticmethod
    def begin(system: System, state: State, phi: Array) -> SlipHistory:
        """From a state that is loaded by phi (n - 1,) all along."""
        phis = [np.full(len(c.s), p) for c, p in zip(system.contacts, phi.tolist(), strict=True)]
        slips = [twist_of(system, state, k) for k in range(len(phis))]
        return SlipHistory(phis, slips, [np.zeros_like(p) for p in phis], system.l_b)

    def __call__(self, system: System, state: State, k: int) -> tuple[Array, Array]:
        trial, axial = self._trial(system, state, k)
        outer, inner = system.contacts[k].twist
        rods = system.rods[k], system.rods[k + 1]
        rows = np.concatenate(
            [np.zeros((len(trial), rods[0].n_bend)), -outer, np.zeros((len(trial), rods[1].n_bend)), -inner], axis=1
        )
        size = np.hypot(trial, axial)
        slope = np.where(size < 1, 1.0, axial**2 / np.maximum(size, 1.0) ** 3)
        return trial / np.maximum(size, 1.0), rows / self.breakaway_m * slope[:, None]

    def _trial(self, system: System, state: State, k: int) -> tuple[Array, Array]:
        """The vectors as if nothing slipped. Tubes do not stretch: along them, pairs slip as their collars move."""
        travel = float(np.diff(system.l_b - self.l_b)[k])
        turned = twist_of(system, state, k) - self.slip[k]
        return self.phi[k] + turned / self.breakaway_m, self.psi[k] + travel / self.breakaway_m

    def scaled(self, share: float) -> FrictionState:
        """This friction with `share` of its coefficients."""

        def state_of(system: System, state: State, k: int) -> tuple[Array, Array]:
            phi, slope = self(system, state, k)
            return share * phi, share * slope

        return state_of

    def after(self, system: System, state: State) -> SlipHistory:
        """The history once `state` was reached."""
        trials = [self._trial(system, state, k) for k in range(len(self.phi))]
        sizes = [np.maximum(np.hypot(*trial), 1.0) for trial in trials]
        phi, psi = ([trial[i] / size for trial, size in zip(trials, sizes, strict=True)] for i in (0, 1))
        slips = [twist_of(system, state, k) for k in range(len(phi))]
        return SlipHistory(phi, slips, psi, system.l_b, self.breakaway_m)

    def moved(self, system: System) -> SlipHistory:
        """This friction at the stations of another mesh, by their order."""

        def there(values: list[Array]) -> list[Array]:
            return [
                np.interp(np.linspace(0, 1, len(contact.s)), np.linspace(0, 1, len(old)), old)
                for old, contact in zip(values, system.contacts, strict=True)
            ]

        return SlipHistory(there(self.phi), there(self.slip), there(self.psi), self.l_b, self.breakaway_m)


def twist_of(system: System, state: State, k: int) -> Array:
    """Circumferential position of the inner tube on the outer one at the stations of pair k [m]."""
    outer, inner = system.contacts[k].twist
    return np.asarray(-outer @ system.parts(state.x, k)[1] - inner @ system.parts(state.x, k + 1)[1])


def remaining(phi: Array, translation_m: Array, release_m: float) -> Array:
    """phi (n - 1,) after the pairs have translated by `translation_m` (n - 1,)."""
    return np.asarray(phi * np.exp(-np.abs(translation_m) / release_m))
