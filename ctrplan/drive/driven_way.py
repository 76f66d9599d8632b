"""Where the joints are driven on the way along a path: on its legs, but for a drive that follows late.

A late drive follows every joint's own command some time after it was given. Where rotations are later than
translations, the joints leave the legs, by what they turn in that time. The way is then that of the motion in time, as
`ctrplan.time_parameterise` makes it of the legs: from rest, and at rest where it ends.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import merge_legs

if TYPE_CHECKING:
    from ctrplan.drive.drive import Drive

STEP_RAD, STEP_M = np.radians(1.0), 0.25e-3  # of a joint, between rows of a way in time, where it is taken as straight

LegWay = tuple[int, Array]  # leg, and joints (S, m) [rad, m] driven on it, straight in between


def driven_ways(drive: Drive, corners: Array) -> list[LegWay]:
    """The ways of the legs between waypoints (K, m), one after the other; of one waypoint a way of no length."""
    if len(corners) == 1:
        return [(0, np.vstack([corners, corners]))]
    if not drive.is_late:
        return [(leg, np.vstack(ends)) for leg, ends in enumerate(pairwise(corners))]
    return _late_ways(drive, corners)


def late_rows(drive: Drive, time_s: Array, position: Array, at_s: Array) -> Array:
    """(K, m) joints at instants (K,), when a motion through position (T, m) at time_s (T,) is commanded."""
    columns = zip(drive.joint_late_s, position.T, strict=True)
    return np.array([np.interp(at_s - late, time_s, column) for late, column in columns]).T


def _late_ways(drive: Drive, corners: Array) -> list[LegWay]:
    from ctrplan.drive.trajectory import time_parameterise  # ruckig takes long to import

    legs = merge_legs(corners)
    made = time_parameterise(corners, drive, joinable=True)
    instants = np.append(made.time_s, made.duration_s + np.unique(drive.joint_late_s))
    instants = np.unique(np.concatenate([instants, np.linspace(made.duration_s, instants[-1], 50)]))
    rows = late_rows(drive, made.time_s, made.position, instants)
    steps = np.abs(np.diff(rows, axis=0)) / np.where(drive.is_rotation, STEP_RAD, STEP_M)
    moved = np.floor(np.append(0.0, np.cumsum(steps.max(axis=1))))
    leg_of_instant = np.minimum(np.searchsorted(made.leg_end_s, instants, side="left"), len(legs) - 2)
    ways = list[LegWay]()
    first = _first_waypoints(corners, legs)
    for leg in range(len(legs) - 1):
        own = np.flatnonzero(leg_of_instant == leg)
        if len(own) == 0:
            continue
        own = np.arange(max(own[0] - 1, 0), own[-1] + 1)  # from where the leg before ends
        kept = np.append(np.flatnonzero(np.diff(moved[own], prepend=-1.0) > 0), len(own) - 1)
        way = rows[own[np.unique(kept)]]
        ways.append((first[leg], way if len(way) > 1 else np.vstack([way, way])))
    return ways


def _first_waypoints(corners: Array, legs: Array) -> list[int]:
    """Number of the leg of corners (K, m) with which each merged leg begins."""
    results, k = [], 0
    for start in legs[:-1]:
        while not np.array_equal(corners[k], start):
            k += 1
        results.append(k)
    return results
