"""Where the joints are driven on the way along a path: on its legs, but for a drive that follows late.

A late drive follows every joint's own command some time after it was given. Where rotations are later than
translations, the joints leave the legs, by what they turn in that time. The way is then that of the motion in time, as
`ctrplan.time_parameterise` makes it of the legs: from rest, and at rest where it ends.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

if TYPE_CHECKING:
    from ctrplan.drive.drive import Drive
    from ctrplan.drive.trajectory import Trajectory

STEP_RAD, STEP_M = np.radians(1.0), 0.25e-3  # of a joint, between rows of a way in time, where it is taken as straight

PASSED = 1e-9  # rad or m, or share of a leg, by which rounding may carry a sample off its leg

LegWay = tuple[int, Array]  # leg, and joints (S, m) [rad, m] driven on it, straight in between


def driven_ways(drive: Drive, corners: Array, timing: Trajectory | None = None) -> list[LegWay]:
    """The ways of the legs between waypoints (K, m), one after the other; of one waypoint a way of no length.

    timing: of a motion along the legs; None for the one that `ctrplan.time_parameterise` makes.
    """
    if len(corners) == 1:
        return [(0, np.vstack([corners, corners]))]
    if not drive.is_late:
        return [(leg, np.vstack(ends)) for leg, ends in enumerate(pairwise(corners))]
    return _late_ways(drive, corners, timing)


def late_rows(drive: Drive, time_s: Array, position: Array, at_s: Array) -> Array:
    """(K, m) joints at instants (K,), when a motion through position (T, m) at time_s (T,) is commanded."""
    columns = zip(drive.joint_late_s, position.T, strict=True)
    return np.array([np.interp(at_s - late, time_s, column) for late, column in columns]).T


def _late_ways(drive: Drive, corners: Array, timing: Trajectory | None) -> list[LegWay]:
    from ctrplan.drive.trajectory import time_parameterise  # ruckig takes long to import

    made = timing or time_parameterise(corners, drive, joinable=True)
    tail_s = made.duration_s + np.linspace(0, float(drive.joint_late_s.max()), 50)
    instants = np.unique(np.concatenate([made.time_s, tail_s]))
    rows = late_rows(drive, made.time_s, made.position, instants)
    legs = _commanded_legs(corners, made.position)[np.minimum(np.arange(len(instants)), len(made.time_s) - 1)]
    steps = np.abs(np.diff(rows, axis=0)) / np.where(drive.is_rotation, STEP_RAD, STEP_M)
    moved = np.floor(np.append(0.0, np.cumsum(steps.max(axis=1))))
    ways = list[LegWay]()
    for leg in range(len(corners) - 1):
        own = np.flatnonzero(legs == leg)
        if len(own) == 0:  # passed between two samples
            own = np.flatnonzero(legs <= leg)[-1:]
        own = np.arange(max(own[0] - 1, 0) if leg else 0, own[-1] + 1)  # from where the leg before ends
        kept = np.append(np.flatnonzero(np.diff(moved[own], prepend=-1.0) > 0), len(own) - 1)
        way = rows[own[np.unique(kept)]]
        ways.append((leg, way if len(way) > 1 else np.vstack([way, way])))
    return ways


def _commanded_legs(corners: Array, position: Array) -> NDArray[np.intp]:
    """(T,) leg of waypoints (K, m) on which joints (T, m), that follow the legs, are commanded."""
    legs, leg = np.empty(len(position), dtype=np.intp), 0
    last = len(corners) - 2
    for k, q in enumerate(position):
        while leg < last and _is_passed(corners[leg], corners[leg + 1], q):
            leg += 1
        legs[k] = leg
    return legs


def _is_passed(start: Array, end: Array, q: Array) -> bool:
    """Whether joints q lie beyond the end of a leg, or off it."""
    chord = end - start
    along = float((q - start) @ chord) / max(float(chord @ chord), 1e-300)
    return along > 1 + PASSED or float(np.abs(q - start - min(max(along, 0.0), 1.0) * chord).max()) > PASSED
