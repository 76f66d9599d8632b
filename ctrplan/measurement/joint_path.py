"""A commanded joint path: waypoints in the order visited, with rotations that were logged within one turn unwrapped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class JointPath:
    """K waypoints of n tubes in the order visited; between them all joints move together linearly."""

    theta_commanded: Array  # (K, n) base rotations, rad, not wrapped
    l_commanded: Array  # (K, n) base translations, m
    sequence: NDArray[np.int_]  # (K,) runs, each approached afresh
    time_s: Array | None = None  # (K,)
    file: str | None = None
    more: Mapping[str, Array] = field(default_factory=dict)  # other columns (K,), NaN where blank
    notes: tuple[str, ...] = ()  # how the file was read, a sentence each
    of_collars: bool = False  # whether joints are those of the collars, so that the drive's effects are in them

    @property
    def runs(self) -> list[slice]:
        """Rows of each run."""
        starts = [*np.flatnonzero(np.diff(self.sequence, prepend=np.nan) != 0).tolist(), len(self.sequence)]
        return [slice(a, b) for a, b in zip(starts, starts[1:], strict=False)]


TURN = 2 * np.pi
NEAR_A_TURN = 0.25 * TURN  # steps that are nearer to one turn may be a wrapped angle's
SMALL_STEP = 1.0  # rad; those of a log, but for a few
FEW = 0.01  # of the steps of a log
STEPS_PER_JUMP = 20  # of a log, at least
EXACT = 1e-6  # rad


def looks_wrapped(theta: Array, sequence: NDArray[np.int_]) -> bool | None:
    """Whether a rotation (R,) [rad] in runs (R,) was kept within one turn. None where it can't be known.

    A log of small steps that now and then jumps by nearly a turn was. Waypoints that are far apart may be meant as they
    are; a step of exactly one turn is.
    """
    step = np.abs(np.diff(theta))[np.diff(sequence) == 0]
    far = _is_near_a_turn(step)
    if not far.any():
        return False
    others = step[~far]
    is_log = len(others) >= STEPS_PER_JUMP * far.sum() and np.mean(others > SMALL_STEP) <= FEW
    if is_log:
        return True
    return False if np.all(np.abs(step[far] - TURN) < EXACT) else None


def jumps(theta: Array, sequence: NDArray[np.int_]) -> NDArray[np.int_]:
    """Rows (from 0) that a rotation (R,) reaches by a step near a full turn."""
    near = _is_near_a_turn(np.abs(np.diff(theta))) & (np.diff(sequence) == 0)
    found: NDArray[np.int_] = np.flatnonzero(near) + 1
    return found


def unwrapped(theta: Array, sequence: NDArray[np.int_]) -> Array:
    """Rotations (R,) [rad] that go on where they jump by nearly a turn."""
    rows, turns = jumps(theta, sequence), np.zeros(len(theta))
    turns[rows] = -np.round((theta[rows] - theta[rows - 1]) / TURN)
    whole: Array = theta + TURN * np.cumsum(turns)
    return whole


def _is_near_a_turn(step: Array) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = np.abs(step - TURN) < NEAR_A_TURN
    return near
