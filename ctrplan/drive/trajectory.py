"""Waypoints of actuated joint values -> jerk-limited joint trajectory, and where the joints are driven on the way. The
only module that imports ruckig.

Every leg is driven from rest to rest on the straight line q(s) = A + s (B - A), s from 0 to 1. On that line the limits
of the joints are limits of the one coordinate s: |s'| <= min_j v_j / |B_j - A_j|, and likewise for s'' and s'''.

A controller that joins samples by cubics (of positions and velocities) or quintics (of accelerations too) drives this
motion where jerk changes at samples only; changing in between it is exceeded by three quarters (test). `joinable`
motions are so: each phase of a leg is as long as the shortest motion's, rounded up to whole periods, with the jerk that
ends the leg in that time, by which speed, acceleration and jerk all become less, never more.

Why one path coordinate and not ruckig's Synchronization.Phase: where the limits that bind belong to different joints
(one is short of velocity, another of jerk), Phase silently falls back to Time synchronisation and leaves the line. The
profile of s is the shortest of all motions that stay on the line; where Phase does stay on it, the duration is the
slowest joint's own optimum, below which no motion can go, so that both agree (`benchmarks/run.py trajectory_limits`).

The joints are driven on the legs, but for a drive that follows late: it follows every joint's own command some time
after it was given. Where rotations are later than translations, the joints leave the legs, by what they turn in that
time. The way is then that of the motion in time, as `time_parameterise` makes it of the legs: from rest, and at rest
where it ends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import ruckig
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import Flag, Made, Number, checked
from ctrplan.base.arrays import Array, numbers
from ctrplan.base.package import shown
from ctrplan.drive.drive import JOINT_ROUNDING, STEP_M, STEP_RAD, Drive
from ctrplan.drive.legs import LINE_TOLERANCE, distance_from_leg, merge_legs, rounding
from ctrplan.errors import InputError, SolverError

QUANTITIES = ("velocity", "acceleration", "jerk")
RATIO_TOLERANCE = 1e-9  # relative excess of a limit that counts as rounding
END_TOLERANCE = 1e-10  # of s, by which rounding may leave the end of a leg
MAX_SAMPLES = 1_000_000
PERIOD_S = 0.01
PERIOD = Number(1e-9, 1e9, "s")
LegWay = tuple[int, Array]  # leg, and joints (S, m) [rad, m] driven on it, straight in between


@shown
@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a motion of the m actuated joints, at rest at its start, at its end and where its legs meet.

    Joint values are continuous (an unlimited rotation keeps its winding), in rad for rotations and m for translations;
    derivatives are per s, s^2, s^3. Samples stand at k * period_s, k = 0, 1, ..., and at the exact end of the motion;
    the last interval lasts between a half and one and a half periods (less only if the whole motion does). Stops fall
    between samples, of joinable motions on them; leg_end_s has their exact instants. Jerk is piecewise constant: a
    sample has the value that holds from it on, the last one 0.
    """

    names: tuple[str, ...]
    time_s: Array  # (T,)
    position: Array  # (T, m)
    velocity: Array  # (T, m)
    acceleration: Array  # (T, m)
    jerk: Array  # (T, m)
    leg_end_s: Array  # (L,) instants of rest after each leg; the last is duration_s
    duration_s: float
    stops: int  # rests between start and end: L - 1
    is_rotation: NDArray[np.bool_]  # (m,)
    marks: Mapping[str, NDArray[np.int_]] = field(default_factory=dict)  # (T,) columns that a table carries besides


@checked(drive=Made("Drive"), period_s=PERIOD, joinable=Flag())
def time_parameterise(
    waypoints: ArrayLike,
    drive: Drive,
    period_s: float = PERIOD_S,
    *,
    rests: Sequence[int] = (),
    joinable: bool = False,
) -> Trajectory:
    """Fastest motion along the straight legs between waypoints (K, m) [rad, m] within the drive's limits.

    Collinear consecutive legs are merged and passed at speed; the drive stops where the direction changes, and at the
    waypoints whose numbers are in `rests`; a late drive waits there. `joinable`: jerk changes at samples only, of
    PERIOD_S at the most, for which a leg takes up to seven periods longer. A single waypoint, or several equal ones,
    give one sample at rest. Raises InputError for malformed waypoints, waypoints out of a joint's range, useless limits
    or period; SolverError where no profile was found or one failed its check.
    """
    _check_drive(drive)
    points = _checked_waypoints(waypoints, drive)
    corners = _corners(points, rests)
    deltas = [end - start for start, end in pairwise(corners)]
    wait_s = float(drive.joint_late_s.max(initial=0.0)) if drive.is_late else 0.0
    waits = np.append(_is_rest(corners, points, rests)[1:-1], [False] * bool(deltas))  # after each leg
    if joinable:
        grid_s = period_s / max(1, math.ceil(period_s / PERIOD_S - RATIO_TOLERANCE))
        steps = [_whole_steps(delta, drive, grid_s) for delta in deltas]
        knots = [_knots_of_steps(each, grid_s) for each in steps]
        waited = waits * math.ceil(wait_s / grid_s - RATIO_TOLERANCE)
        ends = np.cumsum([each.sum() + more for each, more in zip(steps, waited, strict=True)], dtype=np.float64)
        leg_end_s = ends * grid_s
    else:
        knots = [_leg_knots(delta, drive) for delta in deltas]
        waited = waits * wait_s
        leg_end_s = np.cumsum([leg[-1, 0] + more for leg, more in zip(knots, waited, strict=True)], dtype=np.float64)
    duration_s = float(leg_end_s[-1]) if knots else 0.0
    if duration_s >= MAX_SAMPLES * PERIOD_S:
        raise _too_slow(corners, drive, duration_s)
    time_s = _sample_times(duration_s, period_s)
    q, v, a, j = _sample(corners, knots, leg_end_s, time_s)
    stops = max(len(knots) - 1, 0)
    trajectory = Trajectory(tuple(drive.names), time_s, q, v, a, j, leg_end_s, duration_s, stops, drive.is_rotation)
    verify_limits(trajectory, drive)
    _verify_on_legs(trajectory, corners)
    return trajectory


def remade_trajectory(
    waypoints: ArrayLike, drive: Drive, period_s: float, rests: Sequence[int], durations_s: Sequence[float]
) -> Trajectory:
    """The trajectory of waypoints as a plan made it: joinable, unless what it says or played lasts as the other one.

    durations_s: those that are said or were played. Raises what `time_parameterise` does.
    """
    for joinable in (True, False):
        made = time_parameterise(waypoints, drive, period_s, rests=rests, joinable=joinable)
        if any(math.isclose(made.duration_s, stated, rel_tol=RATIO_TOLERANCE, abs_tol=1e-9) for stated in durations_s):
            return made
    return time_parameterise(waypoints, drive, period_s, rests=rests, joinable=True)


def verify_limits(trajectory: Trajectory, drive: Drive) -> dict[str, dict[str, float]]:
    """Worst |value| / limit over the samples, by joint name and then by "velocity", "acceleration" and "jerk".

    Raises SolverError where a ratio exceeds 1 by more than RATIO_TOLERANCE, or a position leaves its joint's range.
    """
    samples = (trajectory.velocity, trajectory.acceleration, trajectory.jerk)
    worst = np.array([np.abs(values).max(axis=0) for values in samples]) / _limits(drive)
    for i, j in np.argwhere(~(worst <= 1 + RATIO_TOLERANCE)):
        limit = f"{QUANTITIES[i]} limit of {_limits(drive)[i, j]:g} {_unit(drive, j, i + 1)}"
        raise SolverError(f"joint {drive.names[j]!r} reaches {worst[i, j]:.9g} times its {limit} in the trajectory.")
    for k, j in np.argwhere(_out_of_range(trajectory.position, drive)):
        where = f"{trajectory.position[k, j]:.9g} {_unit(drive, j)} at {trajectory.time_s[k]:.9g} s"
        raise SolverError(f"joint {drive.names[j]!r} is at {where} of the trajectory: {_range_rule(drive, j)}.")
    return {n: dict(zip(QUANTITIES, map(float, worst[:, j]), strict=True)) for j, n in enumerate(drive.names)}


def distance_from_legs(trajectory: Trajectory, corners: Array) -> float:
    """Largest distance (1 rad as 1 m) of a sample from the leg driven at its time; corners (L + 1, m) of merge_legs."""
    if len(corners) == 1:
        return float(np.linalg.norm(trajectory.position - corners[0], axis=1).max())
    leg = np.searchsorted(trajectory.leg_end_s[:-1], trajectory.time_s, side="right")
    return float(distance_from_leg(trajectory.position, corners[leg], corners[leg + 1]).max())


def _corners(points: Array, rests: Sequence[int]) -> Array:
    """Waypoints (K, m) where the drive stops: changes of direction, and those numbered in `rests`."""
    ends = sorted({0, len(points) - 1, *rests})
    if not 0 <= ends[0] <= ends[-1] < len(points):
        raise InputError(f"must be numbers of waypoints, 0 to {len(points) - 1}", key="rests", value=list(rests))
    parts = [merge_legs(points[a : b + 1]) for a, b in pairwise(ends)]
    return np.concatenate([points[:1], *(part[1:] for part in parts)])


def _is_rest(corners: Array, points: Array, rests: Sequence[int]) -> NDArray[np.bool_]:
    """(K,) whether merged waypoints (K, m) are among points (L, m) whose numbers are in `rests`, in their order."""
    result, k = np.zeros(len(corners), dtype=bool), 0
    for number in sorted(set(rests)):
        while k < len(corners) - 1 and not np.array_equal(corners[k], points[number]):
            k += 1
        result[k] = True
    return result


def _leg_knots(delta: Array, drive: Drive) -> Array:
    """Rows t, s, s', s'', s''' (8, 5) where s of a leg with joint differences delta (m,) changes its jerk."""
    with np.errstate(divide="ignore", over="ignore"):  # a joint that hardly moves bounds nothing
        limits = (_limits(drive) / np.abs(delta)).min(axis=1)
    profile, duration_s = _ruckig_profile(limits)
    time_s = np.cumsum([0.0, *profile.t])
    knots = np.column_stack([time_s, profile.p, profile.v, profile.a, [*profile.j, 0.0]])
    # Speed and acceleration have their extremes at knots, so that this holds between the samples too.
    within = bool(np.all(np.abs(knots[:, 2:]).max(axis=0) <= limits * (1 + RATIO_TOLERANCE)))
    if not within or abs(knots[-1, 1] - 1) > LINE_TOLERANCE or not math.isclose(time_s[-1], duration_s):
        raise SolverError(f"ruckig's profile for the leg {delta.tolist()} misses its end or its limits.")
    return knots


def _whole_steps(delta: Array, drive: Drive, grid_s: float) -> NDArray[np.int_]:
    """(7,) how many steps of grid_s each phase of a leg with joint differences delta (m,) lasts, within limits."""
    with np.errstate(divide="ignore", over="ignore"):  # a joint that hardly moves bounds nothing
        speed, acceleration, jerk = (_limits(drive) / np.abs(delta)).min(axis=1).tolist()
    ramp, hold, cruise = _shortest_phases(speed, acceleration, jerk)
    steps = np.ceil(np.array([ramp, hold, cruise]) / grid_s - RATIO_TOLERANCE).astype(np.int64)
    a, b, c = max(1, int(steps[0])), max(0, int(steps[1])), max(0, int(steps[2]))
    return np.array([a, b, a, c, a, b, a])


def _shortest_phases(speed: float, acceleration: float, jerk: float) -> tuple[float, float, float]:
    """Durations [s] of growing and of constant acceleration, and of constant speed, of the shortest way from 0 to 1."""
    ramp = min(acceleration / jerk, math.sqrt(speed / jerk))
    hold = max(speed / (jerk * ramp) - ramp, 0.0)
    if (way := speed * (2 * ramp + hold)) <= 1:
        return ramp, hold, (1 - way) / speed
    ramp = acceleration / jerk
    hold = (math.sqrt(ramp * ramp + 4 / acceleration) - 3 * ramp) / 2
    return (ramp, hold, 0.0) if hold >= 0 else ((1 / (2 * jerk)) ** (1 / 3), 0.0, 0.0)


def _knots_of_steps(steps: NDArray[np.int_], grid_s: float) -> Array:
    """Rows t, s, s', s'', s''' (8, 5) of the leg whose phases last so many steps (7,)."""
    ramp, hold, cruise = (steps[[0, 1, 3]] * grid_s).tolist()
    knots = np.zeros((8, 5))
    knots[:, 0] = np.concatenate([[0], np.cumsum(steps)]) * grid_s
    knots[:7, 4] = np.array([1, 0, -1, 0, -1, 0, 1]) / (ramp * (ramp + hold) * (2 * ramp + hold + cruise))
    for k, h in enumerate((steps * grid_s).tolist()):
        _, s, v, a, j = knots[k]
        knots[k + 1, 1:4] = s + h * (v + h * (a / 2 + h * j / 6)), v + h * (a + h * j / 2), a + h * j
    if abs(knots[-1, 1] - 1) > END_TOLERANCE:
        raise SolverError(f"the profile of {int(steps.sum())} steps ends at {knots[-1, 1]:.9g} of its leg.")
    return knots


def _ruckig_profile(limits: Array) -> tuple[ruckig.Profile, float]:
    """Shortest profile from rest at s = 0 to rest at s = 1 within limits (3,) of s', s'' and s''', and its duration."""
    request, answer = ruckig.InputParameter(1), ruckig.Trajectory(1)
    request.target_position = [1.0]
    request.max_velocity, request.max_acceleration, request.max_jerk = ([float(limit)] for limit in limits)
    try:
        result = ruckig.Ruckig(1).calculate(request, answer)
    except (ruckig.RuckigError, ValueError) as error:  # ValueError: a result code that its Python enum lacks
        raise SolverError(f"ruckig found no profile for a leg: {' '.join(str(error).split()).rstrip('.')}.") from error
    if result != ruckig.Result.Working:
        raise SolverError(f"ruckig found no profile for a leg: {result.name}.")
    return answer.profiles[0][0], answer.duration


def _path_coordinate(knots: Array, time_s: Array) -> Array:
    """s, s', s'', s''' (4, T) at time_s (T,) since the start of the leg: exact, a cubic between knots."""
    slack = RATIO_TOLERANCE * knots[-1, 0]  # instants are rounded: at a knot the piece holds that begins there
    section = np.searchsorted(knots[:, 0], time_s + slack, side="right") - 1
    begin, s, v, a, j = knots[section].T
    h = time_s - begin
    return np.stack([np.clip(s + h * (v + h * (a / 2 + h * j / 6)), 0, 1), v + h * (a + h * j / 2), a + h * j, j])


def _sample(corners: Array, knots: Sequence[Array], leg_end_s: Array, time_s: Array) -> Array:
    """Position, velocity, acceleration and jerk (4, T, m) at time_s (T,)."""
    motion = np.zeros((4, len(time_s), corners.shape[1]))
    leg_start_s = np.concatenate([[0.0], leg_end_s])
    rows = [slice(*pair) for pair in pairwise(np.searchsorted(time_s, leg_start_s))]
    for leg, row, begin, a, b in zip(knots, rows, leg_start_s, corners, corners[1:], strict=False):
        s, *derivatives = _path_coordinate(leg, time_s[row] - begin)[:, :, None]
        motion[0, row] = a + s * (b - a)
        motion[1:, row] = np.stack(derivatives) * (b - a)
    motion[0, -1] = corners[-1]  # the end of the last leg is in no half-open interval: at rest
    return motion


def _sample_times(duration_s: float, period_s: float) -> Array:
    if duration_s == 0:
        return np.zeros(1)
    if duration_s / period_s >= MAX_SAMPLES:
        rule = f"samples a motion of {duration_s:.6g} s more than {MAX_SAMPLES} times"
        raise InputError(rule, key="period_s", value=period_s, unit="s")
    return np.append(np.arange(max(math.floor(duration_s / period_s - 0.5), 0) + 1) * period_s, duration_s)


def _verify_on_legs(trajectory: Trajectory, corners: Array) -> None:
    distance = distance_from_legs(trajectory, corners)
    if not distance <= LINE_TOLERANCE + rounding(corners):
        raise SolverError(f"the trajectory leaves its straight legs by {distance:.3g} (rad, m).")


def _too_slow(corners: Array, drive: Drive, duration_s: float) -> InputError:
    """The error that a motion takes days, said of the joint's limit that makes it take them, as a robot file has it."""
    way = np.abs(np.diff(corners, axis=0)).max(axis=0)
    order = np.arange(1, len(QUANTITIES) + 1)[:, None]
    i, j = np.unravel_index(np.argmax((way / _limits(drive)) ** (1 / order)), (len(QUANTITIES), len(way)))
    joint = drive.joints[int(j)]
    power = "" if i == 0 else str(i + 1)
    key = f"joint.{j + 1}.max_{QUANTITIES[i]}_{joint.unit}_s{power}"
    rule = f"lets a motion take {duration_s:.3g} s, must be at most {MAX_SAMPLES * PERIOD_S:g} s"
    value = float(_limits(drive)[i, j]) / joint.si_per_unit
    return InputError(rule, key=key, value=value, unit=f"{joint.unit}/s{'^' if power else ''}{power}")


def _checked_waypoints(waypoints: ArrayLike, drive: Drive) -> Array:
    points = numbers(waypoints, "waypoints").copy()
    if points.ndim != 2 or 0 in points.shape or points.shape[1] != len(drive.names):
        rule = f"must be (K, {len(drive.names)}), K at least 1, one value per joint: {', '.join(drive.names)}"
        raise InputError(rule, key="shape of waypoints", value=points.shape)
    for k, j in np.argwhere(~np.isfinite(points) | _out_of_range(points, drive)):
        rule = _range_rule(drive, j) if np.isfinite(points[k, j]) else "must be a finite number"
        key = f"waypoint.{k + 1}.{drive.names[j]}"
        raise InputError(rule, key=key, value=float(points[k, j]), unit=_unit(drive, j))
    return points


def _check_drive(drive: Drive) -> None:
    names = ("lower", "upper", *(f"max_{quantity}" for quantity in QUANTITIES))
    for name in names:
        if getattr(drive, name).shape != (len(drive.names),):
            raise InputError("must have one value per joint", key=name, value=getattr(drive, name).tolist())
    for i, j in np.argwhere(~((_limits(drive) > 0) & np.isfinite(_limits(drive)))):
        key, value = f"joint.{j + 1}.{names[2 + i]}", float(_limits(drive)[i, j])
        raise InputError("must be a positive, finite number", key=key, value=value, unit=_unit(drive, j, i + 1))


def _limits(drive: Drive) -> Array:
    return np.stack([drive.max_velocity, drive.max_acceleration, drive.max_jerk])


def _out_of_range(points: Array, drive: Drive) -> NDArray[np.bool_]:
    outside: NDArray[np.bool_] = (points < drive.lower - JOINT_ROUNDING) | (points > drive.upper + JOINT_ROUNDING)
    return outside


def _range_rule(drive: Drive, j: int) -> str:
    return f"must lie between {drive.lower[j]:.9g} and {drive.upper[j]:.9g} {_unit(drive, j)}"


def _unit(drive: Drive, j: int, order: int = 0) -> str:
    return ("rad" if drive.is_rotation[j] else "m") + ("", "/s", "/s^2", "/s^3")[order]


SPEEDING = 1e-3  # share of a joint's largest speed by which samples may exceed it: rounding of what was written


def driven_ways(drive: Drive, corners: Array, timing: Trajectory | None = None) -> list[LegWay]:
    """The ways of the legs between waypoints (K, m), one after the other; of one waypoint a way of no length.

    timing: of a motion along the legs; None for the one that `ctrplan.time_parameterise` makes.
    """
    if len(corners) == 1:
        return [(0, np.vstack([corners, corners]))]
    if not drive.is_late:
        return [(leg, np.vstack(ends)) for leg, ends in enumerate(pairwise(corners))]
    return _late_ways(drive, corners, timing)


def too_fast(drive: Drive, time_s: Array, position: Array) -> list[tuple[str, float, float]]:
    """Joints that are faster between samples, position (T, m) at times (T,), than they can go: name, speed, limit."""
    speeds = (np.abs(np.diff(position, axis=0)) / np.diff(time_s)[:, None]).max(axis=0, initial=0.0)
    each = zip(drive.names, speeds.tolist(), drive.max_velocity.tolist(), strict=True)
    return [(name, speed, limit) for name, speed, limit in each if speed > limit * (1 + SPEEDING)]


def late_rows(drive: Drive, time_s: Array, position: Array, at_s: Array) -> Array:
    """(K, m) joints at instants (K,), when a motion through position (T, m) at time_s (T,) is commanded."""
    columns = zip(drive.joint_late_s, position.T, strict=True)
    return np.array([np.interp(at_s - late, time_s, column) for late, column in columns]).T


def _late_ways(drive: Drive, corners: Array, timing: Trajectory | None) -> list[LegWay]:
    made = timing or time_parameterise(corners, drive, joinable=True)
    instants = np.unique(np.add.outer(made.time_s, [0.0, *drive.joint_late_s]))  # between which all joints go straight
    rows = late_rows(drive, made.time_s, made.position, instants)
    commanded = np.searchsorted(made.time_s, instants, side="right") - 1
    legs = _commanded_legs(corners, made.position)[commanded]
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
    """Whether joints q lie off a leg, which they do beyond its end, too."""
    chord = end - start
    along = float((q - start) @ chord) / max(float(chord @ chord), 1e-300)
    return float(np.abs(q - start - min(max(along, 0.0), 1.0) * chord).max()) > JOINT_ROUNDING
