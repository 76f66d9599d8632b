"""How joints moved on the way to each pose: time at rest, speeds, use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.experiment.measurements import SAME_ROTATION_RAD, SAME_TRANSLATION_M, Measurements


def clock(data: Measurements) -> Array:
    """(K,) [s] of the poses; a log without times counts its rows."""
    found: Array = data.rows.astype(float) if data.time_s is None else data.time_s[data.rows]
    return found


def rest_began(data: Measurements) -> NDArray[np.int_]:
    """(R,) the waypoint from which on no joint has moved."""
    joints = np.hstack([data.theta_commanded, data.l_commanded])
    limit = np.repeat([SAME_ROTATION_RAD, SAME_TRANSLATION_M], data.n)
    moved = np.any(np.abs(np.diff(joints, axis=0)) > limit, axis=1) | (np.diff(data.sequence) != 0)
    starts = np.concatenate([[True], moved])
    began: NDArray[np.int_] = np.flatnonzero(starts)[np.cumsum(starts) - 1]
    return began


def time_at_rest_s(data: Measurements) -> Array:
    """(K,) since the last joint moved; zeros without a clock."""
    if data.time_s is None:
        return np.zeros(data.count)
    since: Array = (data.time_s - data.time_s[rest_began(data)])[data.rows]
    return since


def turning_speeds(data: Measurements) -> Array:
    """(K, n - 1) [rad/s] at which the tubes of each pair turned against each other; zeros without a clock."""
    speeds = np.zeros((len(data.sequence), data.n - 1))
    if data.time_s is not None:
        turns, times = np.diff(np.diff(data.theta_commanded, axis=1), axis=0), np.diff(data.time_s)
        going = (times > 0) & (np.diff(data.sequence) == 0)
        speeds[1:][going] = turns[going] / times[going, None]
    return speeds[data.rows]


def use_left(data: Measurements) -> Array:
    """(K,) share of all turning of tubes against each other that is still to come: 1 at first, 0 at the end."""
    turns = np.abs(np.diff(np.diff(data.theta_commanded, axis=1), axis=0)).sum(axis=1)
    done = np.concatenate([[0.0], np.cumsum(turns)])
    left: Array = 1 - done[data.rows] / max(done[-1], 1e-12)
    return left
