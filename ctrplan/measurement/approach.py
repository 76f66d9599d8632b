"""How each measured pose was approached: directions, friction states, speeds, time at rest, and the waypoints that
matter.

The rule of Ha et al. 2019, Section V: a relative rotation of 90 degrees saturates friction in its direction, an
oscillation of decreasing amplitude releases it. In between, a play operator: the state follows the relative rotation
elastically over `BREAKAWAY_RAD` and slips beyond. For continuous motions a simulated history is better.

Logs have many waypoints on one straight line of joints, and more while nothing moves. Between those that are kept all
joints move together linearly, as ever.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, read_only
from ctrplan.measurement.measurements import SAME_ROTATION_RAD, SAME_TRANSLATION_M, Measurements

RELEASING_SWINGS = 6  # that many, each smaller than the one before, are a decreasing oscillation
BREAKAWAY_RAD = np.radians(30.0)  # relative rotation from released to slipping everywhere (docs/diagnosis.md)
LARGEST_STEP_RAD = np.radians(270.0)  # between two poses at rest, by which few drives turn and many logs wrap

_DIRECTIONS: WeakKeyDictionary[Measurements, Array] = WeakKeyDictionary()  # fits ask hundreds of times
_PLAIN_STATES: WeakKeyDictionary[Measurements, Array] = WeakKeyDictionary()


def friction_state(data: Measurements, release_m: float = np.inf) -> Array:
    """(K, n - 1) circumferential share of the Coulomb limit at every pose, each run starting released.

    A relative translation by `release_m` turns the friction axial and leaves 1/e of the circumferential share.
    """
    if np.isfinite(release_m):
        return _followed(data, release_m)
    if data not in _PLAIN_STATES:
        _PLAIN_STATES[data] = read_only(_followed(data, release_m))
    return _PLAIN_STATES[data]


def _followed(data: Measurements, release_m: float) -> Array:
    """Turning and sliding at constant rates between waypoints: d state = d turn - state d slide, inside [-1, 1]."""
    turn = np.diff(np.diff(data.theta_commanded, axis=1), axis=0) / BREAKAWAY_RAD
    slide = np.abs(np.diff(np.diff(data.l_commanded, axis=1), axis=0)) / release_m
    driven = np.where(slide > 1e-9, turn * -np.expm1(-slide) / np.maximum(slide, 1e-9), turn)
    decay = np.exp(-slide) * (np.diff(data.sequence) == 0)[:, None]  # every run starts anew
    driven[np.diff(data.sequence) != 0] = 0.0
    states = np.zeros((len(data.sequence), data.n - 1))
    for pair in range(data.n - 1):
        states[1:, pair] = _within_limits(driven[:, pair].tolist(), decay[:, pair].tolist())
    return states[data.rows]


def _within_limits(driven: Sequence[float], decay: Sequence[float]) -> list[float]:
    """State after every step."""
    states, state = list[float](), 0.0
    for more, left in zip(driven, decay, strict=True):
        state = min(max(state * left + more, -1.0), 1.0)
        states.append(state)
    return states


def last_directions(data: Measurements) -> Array:
    """(K, 2 n) sign of the last motion of each rotation, then of each translation.

    0 where the run has not moved the actuator yet, and after an oscillation of decreasing amplitude, which leaves play
    and elastic wind-up of a drive in the middle.
    """
    if data not in _DIRECTIONS:
        _DIRECTIONS[data] = read_only(_last_directions(data))
    return _DIRECTIONS[data]


def _last_directions(data: Measurements) -> Array:
    joints = np.hstack([data.theta_commanded, data.l_commanded])
    still = np.repeat([SAME_ROTATION_RAD, SAME_TRANSLATION_M], data.n) / 10
    directions = np.zeros((data.count, joints.shape[1]))
    for run in np.unique(data.sequence[data.rows]).tolist():
        waypoints, poses = np.flatnonzero(data.sequence == run), data.sequence[data.rows] == run
        steps = np.diff(joints[waypoints], axis=0)
        for j in range(joints.shape[1]):
            after = _directions_along(steps[:, j], still[j])
            directions[poses, j] = after[data.rows[poses] - waypoints[0]]
    return directions


def _directions_along(steps: Array, still: float) -> Array:
    """(R,) direction of an actuator at each waypoint of a run with R - 1 steps."""
    directions, swings, sizes = [0.0], [0.0], [0.0]
    for step in steps.tolist():
        if abs(step) > still:
            if step * swings[-1] > 0:
                swings[-1] += step
            else:
                swings.append(step)
            sizes = [abs(swing) for swing in swings[-RELEASING_SWINGS:]]
        released = len(swings) > RELEASING_SWINGS and all(b < a for a, b in pairwise(sizes))
        directions.append(0.0 if released or not swings[-1] else math.copysign(1.0, swings[-1]))
    return np.array(directions)


def clock(data: Measurements) -> Array:
    """(K,) [s] of the poses; a log without times counts its rows."""
    result: Array = data.rows.astype(float) if data.time_s is None else data.time_s[data.rows]
    return result


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


STRAIGHT_RAD, STRAIGHT_M = np.radians(0.3), 0.1e-3  # off a straight line that friction does not feel: it needs 30 deg


def needed_waypoints(theta: Array, l: Array, rows: NDArray[np.int_]) -> NDArray[np.int_]:  # noqa: E741
    """Numbers, in order, of the waypoints of a run (R, n) without those that lie on lines between others.

    Kept are the first, those of `rows`, and as many others as leave none farther off than 0.3 deg or 0.1 mm.
    """
    joints = np.hstack([theta / STRAIGHT_RAD, l / STRAIGHT_M])
    kept = np.zeros(len(joints), bool)
    kept[rows] = kept[0] = True
    stretches = [*zip(np.flatnonzero(kept)[:-1].tolist(), np.flatnonzero(kept)[1:].tolist(), strict=True)]
    while stretches:
        a, b = stretches.pop()
        if b - a > 1 and (far := _farthest(joints[a : b + 1])):
            kept[a + far] = True
            stretches += [(a, a + far), (a + far, b)]
    return np.flatnonzero(kept)


def _farthest(joints: Array) -> int:
    """The point, of (M, d) between the first and the last, that is farthest off their line; 0 if none is."""
    start, along = joints[0], joints[-1] - joints[0]
    length = float(along @ along)
    places = np.clip((joints - start) @ along / length, 0.0, 1.0) if length > 0 else np.zeros(len(joints))
    away = np.abs(joints - start - places[:, None] * along).max(axis=1)
    far = int(away.argmax())
    return far if away[far] > 1 else 0


def how_taken(data: Measurements) -> list[str]:
    """Sentences about how poses were taken, where rows alone say so: each of one file, none measured on the way."""
    if data.is_stream:
        return []
    rows, runs = data.rows, data.sequence[data.rows]
    at_once = (np.diff(rows) == 1) & (np.diff(runs) == 0)
    theta = data.theta_commanded[rows]
    moved = np.abs(np.diff(theta, axis=0)).max(axis=1) > 0 if len(theta) > 1 else np.zeros(0, bool)
    if not (at_once & moved).sum() > len(rows) / 2:
        return []
    sentences = [
        "Every row is taken for a pose at rest, to which the robot was driven from the row before; a mapping file says "
        "otherwise with at_rest = false."
    ]
    steps = np.abs(np.diff(theta, axis=0))
    wide = np.argwhere((steps > LARGEST_STEP_RAD) & at_once[:, None])
    if len(wide):
        k, i = wide[0].tolist()
        where = f"Between rows {rows[k] + 1} and {rows[k + 1] + 1} rotation {i + 1} changes by"
        sentences.append(
            f"{where} {np.degrees(steps[k, i]):.0f} deg ({len(wide)} such steps). If the log wraps rotations, say "
            "so in a mapping file with rotations: friction heeds the way."
        )
    return sentences
