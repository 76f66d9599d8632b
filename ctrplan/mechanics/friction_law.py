"""A law of friction per pair of tubes, cheap enough for planning: rotation loads it, translation releases it.

A pair is one bristle: its friction state phi in [-1, 1] is the twist that friction holds, over the most it can hold.
Turning the inner tube's base by `loading_rad` relative to the outer one's takes phi from 0 to 1. While the tubes also
slide along each other, friction points against the slip, of which only the circumferential share holds twist:

    loading * d phi = d theta - |d l| / r * phi / sqrt(1 - phi^2),

r the radius of contact: translation by a few times `release_m` = r * loading leaves little, and a rotation at the
same time keeps tan(asin phi) = r d theta / |d l|. Pairs locked in translation are never released.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

LOCKED_M = 1e-12  # translation that counts as none
SUBSTEPS = 4  # of a leg between two waypoints
BISECTIONS = 40
_SHARES = np.concatenate([np.linspace(1.0, 0.02, 400), np.geomspace(0.02, 1e-9, 100)[1:]])
_COSINES = np.sqrt(1 - _SHARES**2)
# translation over release_m that takes a pair from fully loaded to each of _SHARES
_TRAVEL = np.where(_SHARES > 1e-3, np.arctanh(np.minimum(_COSINES, 1 - 1e-9)) - _COSINES, np.log(2 / _SHARES) - 1)


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """The law of a robot with P = n - 1 pairs, and how far its tips were from simulated ones when it was calibrated."""

    loading_rad: Array  # (P,) relative base rotation from unloaded to the Coulomb limit
    release_m: Array  # (P,) relative translation scale of release; inf: never
    error_rms_m: float = np.nan  # of the tip against simulated histories, over all their samples
    error_p95_m: float = np.nan  # exceeded by 5 % of the samples
    deviation_rms_m: float = np.nan  # of the simulated tips from the frictionless ones: the error of no law at all

    def advance(self, phi: Array, theta_rad: Array, l_m: Array) -> Array:
        """States (..., P) after relative rotations (..., P) [rad] and translations (..., P) [m], one implicit step."""
        return _step(phi + theta_rad / self.loading_rad, np.abs(l_m) / self.release_m)

    def follow(self, theta_b: Array, l_b: Array, phi: Array) -> Array:
        """States (K, ..., P) along waypoints (K, n) [rad], (K, n) [m], starting from phi (..., P) at the first."""
        states = [np.asarray(phi, dtype=np.float64)]
        for turn, slide in zip(np.diff(np.diff(theta_b), axis=0), np.diff(np.diff(l_b), axis=0), strict=True):
            state = states[-1]
            for _ in range(SUBSTEPS):
                state = self.advance(state, turn / SUBSTEPS, slide / SUBSTEPS)
            states.append(state)
        return np.array(states)

    def load_left(self, load: Array, theta_b: Array, l_b: Array, fraction: Array) -> Array:
        """(K, P) largest |phi| possible at fractions (K,) of a leg, given the largest possible at its start, (P,).

        The leg goes straight from row 0 to row 1 of theta_b (2, n) and l_b (2, n). Any rotation may load every pair, as
        tubes drag their neighbours; a rotation during a translation adds what it holds in the long run, which is an
        upper bound of the law.
        """
        turn = np.abs(np.diff(np.diff(theta_b), axis=0)).max(initial=0.0) / self.loading_rad
        slide = np.abs(np.diff(np.diff(l_b), axis=0)[0])
        locked = slide <= LOCKED_M
        travel = np.where(locked, 0.0, slide / self.release_m)
        held = np.where(locked, 0.0, turn / np.hypot(turn, np.where(travel > 0, travel, 1.0)))
        loaded = load + fraction[:, None] * turn
        released = released_share(load, fraction[:, None] * travel) + held
        left: Array = np.minimum(1.0, np.where(travel > 0, released, loaded))
        return left


def released_share(load: Array, travel: Array) -> Array:
    """What translation by `travel` (in units of release_m) leaves of a load in [0, 1]."""
    start = np.interp(-np.asarray(load), -_SHARES, _TRAVEL)
    left: Array = np.interp(start + travel, _TRAVEL, _SHARES)
    return left


def tip_deviations(corner_tip_m: Array, tip_m: Array, phi: Array) -> Array:
    """(K, 3) [m] deviations of the tip from the frictionless one at friction states phi (K, P).

    Exact at the corners, tips (K, 2**P, 3), and at phi = 0, tips (K, 3); multilinear in phi between the corners plus a
    parabola that takes their mean to the frictionless tip.
    """
    signs = corner_signs(phi.shape[1])
    away = corner_tip_m - tip_m[:, None]
    weights = np.prod(1 + signs * phi[:, None, :], axis=2) / len(signs)
    bow = (np.mean(phi**2, axis=1) if phi.shape[1] else np.zeros(len(phi))) - 1
    deviation: Array = np.einsum("kc,kcx->kx", weights, away) + bow[:, None] * away.mean(axis=1)
    return deviation


def largest_deviation(corner_tip_m: Array, tip_m: Array, load: Array) -> Array:
    """(K,) [m] largest deviation of the tip with every |phi| at `load` (K, P), over all signs."""
    sizes = [
        np.linalg.norm(tip_deviations(corner_tip_m, tip_m, sign * load), axis=1) for sign in corner_signs(load.shape[1])
    ]
    largest: Array = np.max(sizes, axis=0)
    return largest


@cache
def corner_signs(pairs: int) -> NDArray[np.float64]:
    """(2**pairs, pairs) friction states in which every pair is fully loaded, one way or the other."""
    return np.array(list(itertools.product((1.0, -1.0), repeat=pairs))).reshape(2**pairs, pairs)


def _step(trial: Array, slide: Array) -> Array:
    """phi = sin a, sin a + slide * tan a = trial: the backward Euler step of the law; clipped where slide is 0."""
    low = np.full(np.broadcast_shapes(np.shape(trial), np.shape(slide)), -np.pi / 2)
    high = -low
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        above = np.sin(middle) + slide * np.tan(middle) > trial
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    phi: Array = np.sin(0.5 * (low + high))
    return phi
