"""measurements.csv, or a mapping file -> Measurements. Every fault is one sentence: file, row, column, value, rule."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import STILL_M, STILL_RAD
from ctrplan.files.joint_path_file import joint_path
from ctrplan.files.mapping_file import POSITION, TANGENT, Source, sources
from ctrplan.measurement.joint_path import joined_measurements
from ctrplan.measurement.measurements import Measurements, is_streamed
from ctrplan.pipeline.chain import Chain
from ctrplan.pipeline.tip_table import registered
from ctrplan.robot.magnitudes import in_words, likely_units
from ctrplan.robot.robot import Robot
from ctrplan.storage.csv_table import CsvTable

AXES = "xyz"


@dataclass(frozen=True, eq=False)
class MarkerColumns:
    """A marker of the robot where a table has it."""

    number: int  # from 1
    columns: tuple[str, str, str]
    position_m: Array  # (N, 3); NaN for an axis along which it was seen
    rows: NDArray[np.int_]  # (N,)
    notes: tuple[str, ...]


def marker_columns(table: CsvTable, robot: Robot, *, is_registered: bool) -> list[MarkerColumns]:
    """Markers with two or three columns in the table. Raises InputError for a single column, and for half a row."""
    results = []
    for number, marker in enumerate(robot.markers, start=1):
        there = [name in table.header for name in marker.columns]
        names = [name for name, given in zip(marker.columns, there, strict=True) if given]
        if not names:
            continue
        if len(names) == 1:
            raise table.fault("one coordinate of a marker says too little, give two or all three", column=names[0])
        if len(names) == 2 and not is_registered:
            raise table.fault("two coordinates of a marker say too little where the frame is unknown", column=names[0])
        position = np.full((len(table.rows), 3), np.nan)
        position[:, there] = np.column_stack([table.numbers(name, blanks=True) for name in names])
        given = np.isfinite(position[:, there])
        for row in np.flatnonzero(given.any(axis=1) & ~given.all(axis=1)).tolist():
            rule = f"is empty, a marker needs all of {', '.join(names)} or none"
            raise table.fault(rule, row, names[int(given[row].argmin())])
        rows = np.flatnonzero(given.all(axis=1))
        along = "" if all(there) else AXES[there.index(False)]
        notes = (f"{table.file}: there is no {marker.name}_{along}_m: it is taken for seen along {along}.",)
        results.append(MarkerColumns(number, marker.columns, position[rows], rows, notes if along else ()))
    return results


def with_markers(
    position: Array, tangent: Array, rows: NDArray[np.int_], seen: Sequence[MarkerColumns]
) -> tuple[Array, Array, NDArray[np.int_], NDArray[np.int_]]:
    """Positions (K, 3), tangents (K, 3), rows (K,) and marker numbers (K,): tips first, then marker after marker."""
    numbers = [np.zeros(len(rows), int), *(np.full(len(point.rows), point.number) for point in seen)]
    return (
        np.concatenate([position, *(point.position_m for point in seen)]),
        np.concatenate([tangent, *(np.full((len(point.rows), 3), np.nan) for point in seen)]),
        np.concatenate([rows, *(point.rows for point in seen)]),
        np.concatenate(numbers),
    )


def noise_ratio(robot: Robot, marker: NDArray[np.int_]) -> Array | None:
    """(K,) noise of each position over a tip's, by the numbers of their markers (K,), 0: the tip; None if alike."""
    stated = robot.measurement
    if stated is None or all(point.position_sigma_m is None for point in robot.markers):
        return None
    ratios = [1.0, *((m.position_sigma_m or stated.position_sigma_m) / stated.position_sigma_m for m in robot.markers)]
    result: Array = np.array(ratios)[marker]
    return result


TANGENT_TOLERANCE = 0.01  # of its length: files are rounded
FURTHEST = 2.0  # tip from the base, in lengths of the longest tube


def load_measurements(path: str | os.PathLike[str], robot: Robot) -> Measurements:
    """The waypoints and poses of a CSV file, or of the files that a mapping file names, which go with `robot`.

    Raises InputError, one sentence with file, row, column, value and rule, for anything malformed or contradictory.
    """
    given = sources(path, robot, "file of measurements")
    parts = [_measurements(source, robot) for source in given]
    data = joined_measurements(parts, [source.tracker for source in given], [source.homing for source in given])
    if given[0].at_rest is not None:
        data = replace(data, is_stream=not given[0].at_rest)
    if np.ptp(data.theta_commanded, axis=0).max() < STILL_RAD and np.ptp(data.l_commanded, axis=0).max() < STILL_M:
        raise given[0].table.fault("all joints are constant: one configuration says nothing about a model")
    unknown = dict.fromkeys(source.tracker for source in given if not source.is_registered)
    trackers = list(dict.fromkeys(source.tracker for source in given))
    data = registered(robot, data, {trackers.index(name) + 1: name for name in unknown})
    theta, l = data.theta_commanded[data.rows], data.l_commanded[data.rows]  # noqa: E741 (as in the equations)
    more = *_still_joints(theta, l, str(data.file)), *_left_out(robot, data), *_time_doubt(robot, data)
    return replace(data, warnings=(*data.warnings, *more))


def _measurements(source: Source, robot: Robot) -> Measurements:
    """One table's."""
    table = source.table
    seen = marker_columns(table, robot, is_registered=source.is_registered)
    bare = bool(seen) and not any(name in table.header for name in (*POSITION, *TANGENT))  # of markers alone
    known = (*TANGENT, *(name for point in seen for name in point.columns))
    joints = joint_path(source, robot, needed=("sequence", *(() if bare else POSITION)), known=known)
    position, tangent, rows = (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int)) if bare else _poses(table, seen)
    _check_positions(table, position, rows, POSITION, robot, anywhere=not source.is_registered)
    for point in seen:
        _check_positions(table, point.position_m, point.rows, point.columns, robot, anywhere=not source.is_registered)
    position, tangent, rows, marker = with_markers(position, tangent, rows, seen)
    return Measurements(
        sequence=joints.sequence,
        theta_commanded=joints.theta_commanded,
        l_commanded=joints.l_commanded,
        rows=rows,
        position_m=position,
        tangent=tangent,
        time_s=joints.time_s,
        is_stream=is_streamed(
            joints.sequence,
            rows,
            np.hstack([joints.theta_commanded, joints.l_commanded]),
            None if seen else position,
        ),
        more=joints.more,
        file=table.file,
        sha256=table.sha256,
        warnings=(*joints.notes, *_marker_poses(table), *(note for point in seen for note in point.notes)),
        of_collars=joints.of_collars,
        marker=marker if seen else None,
        noise_ratio=noise_ratio(robot, marker),
    )


def _poses(table: CsvTable, markers: Sequence[MarkerColumns]) -> tuple[Array, Array, NDArray[np.int_]]:
    """Positions (K, 3) [m], tangents (K, 3) with NaN for what was not measured, and the rows (K,) they stand in."""
    seen = [name for name in TANGENT if name in table.header]
    if len(seen) == 1:
        raise table.fault("one component of a tangent says nothing, give two, all three or none", column=seen[0])
    names = (*POSITION, *seen)
    pose = np.column_stack([table.numbers(name, blanks=True) for name in names])
    given = np.isfinite(pose)
    bare = given[:, :3].all(axis=1) & ~given[:, 3:].any(axis=1)  # a position alone
    for row in np.flatnonzero(given.any(axis=1) & ~given.all(axis=1) & ~bare).tolist():
        rule = f"is empty, a pose needs all of {', '.join(names)}" + (", or the first three alone" if seen else "")
        raise table.fault(rule, row, names[int(given[row].argmin())])
    rows = np.flatnonzero(given[:, :3].all(axis=1))
    if not len(rows) and not any(len(marker.rows) for marker in markers):
        raise table.fault(f"holds no pose: {', '.join(names)} are empty in every row")
    tangent = np.full((len(rows), 3), np.nan)
    if seen:
        tangent[:, [TANGENT.index(name) for name in seen]] = _unit(table, pose[rows, 3:], rows, seen)
    return pose[rows, :3], tangent, rows


def _unit(table: CsvTable, tangent: Array, rows: NDArray[np.int_], names: Sequence[str]) -> Array:
    """The vectors at unit length; two components are a direction in their plane, whatever their length."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
    whole, given = len(names) == len(TANGENT), np.isfinite(tangent).all(axis=1)
    wrong = np.abs(length - 1) > TANGENT_TOLERANCE if whole else ~((length > 1e-6) & (length < 1 + TANGENT_TOLERANCE))
    for k in np.flatnonzero(wrong[:, 0] & given).tolist():
        rule = "must be a unit vector" if whole else "seen in a plane it must be above 0 and at most 1"
        shown = f"tangent has length {length[k, 0]:.4g}, {rule}"
        raise table.fault(shown, int(rows[k]), names[0], tangent[k, 0])
    unit: Array = tangent / length
    return unit


def _check_positions(
    table: CsvTable,
    position: Array,
    rows: NDArray[np.int_],
    columns: Sequence[str],
    robot: Robot,
    *,
    anywhere: bool,
) -> None:
    """Within reach of the base; `anywhere`: of their own middle, where nobody knows the base."""
    if not len(position):
        return
    what = "tip" if columns[0] == POSITION[0] else "marker"
    for k in np.flatnonzero((position == 0).all(axis=1)).tolist():
        rule = f"{what} is 0 in all coordinates, as trackers write what they do not see: leave it empty there"
        raise table.fault(rule, int(rows[k]), columns[0], position[k, 0])
    seen = np.isfinite(position).all(axis=0)
    position = position[:, seen]
    with np.errstate(over="ignore"):  # what is beyond all numbers is too far
        middle = np.median(position, axis=0) if anywhere else np.zeros(position.shape[1])
        far = np.linalg.norm(position - middle, axis=1)
    limit = FURTHEST * max(tube.length_m for tube in robot.tubes)
    for k in np.flatnonzero(far > limit).tolist():
        wide = np.abs(position[k] - middle) > limit  # of some axes alone, whose place the others say
        is_some = bool(wide.any() and not wide.all())
        size = np.linalg.norm((position - middle)[:, wide], axis=1) if is_some else far
        likely = likely_units(float(np.median(size)), "m", (0.01 if is_some else 0.1) * limit, limit)
        first = int(np.argmax(wide))
        unit = f", are these {in_words(likely)}?" if likely else ""
        rule = f"{what} is {far[k]:g} m from the base, beyond the reach of {limit:.3g} m{unit}"
        raise table.fault(rule, int(rows[k]), np.array(columns)[seen].tolist()[first], position[k, first])
    if np.median(far) < limit / 2000 and not anywhere:
        raise table.fault(f"{what}s are {np.median(far):.2g} m from the base, are these metres?", column=columns[0])


def _still_joints(theta_b: Array, l_b: Array, file: str) -> list[str]:
    """One sentence per pair of tubes that never turned and per tube that never moved inside the others."""
    still = []
    for i in range(1, theta_b.shape[1]):
        if np.ptp(theta_b[:, i] - theta_b[:, i - 1]) < STILL_RAD:
            still.append(f"{file}: tubes {i} and {i + 1} never turn against each other: their pair is not testable.")
    if np.ptp(l_b, axis=0).max() < STILL_M:
        still.append(f"{file}: no tube is ever moved along: lengths and translations are not testable.")
    return still


CLOCKS_S = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0, "hours": 3600.0}
WAITS = 0.2, 200.0  # times that the drive needs at full speed from row to row, which people and programs leave it


def _time_doubt(robot: Robot, data: Measurements) -> Iterator[str]:
    """A sentence about times from row to row in which the drive can't have moved so, or would have stood for hours."""
    if data.time_s is None:
        return
    drive = robot.drive
    speed = [joint.max_velocity for joint in drive.joints]
    turned, moved = np.abs(drive.matrix_theta) @ speed, np.abs(drive.matrix_l) @ speed
    steps = [np.abs(np.diff(values, axis=0)) for values in (data.theta_commanded, data.l_commanded)]
    steps[0] = np.minimum(steps[0], 2 * np.pi)  # turns are not made in vain: more are degrees
    with np.errstate(divide="ignore", invalid="ignore"):  # of tubes that no joint moves
        by_tube = np.hstack([steps[0] / turned, steps[1] / moved])
    need, left = np.where(np.isfinite(by_tube), by_tube, 0.0).max(axis=1), np.diff(data.time_s)
    need = np.where(left > 0, need, 0.0)  # clocks of several files begin again
    if not (need > 0).any():
        return
    share = float(np.median(left[need > 0] / need[need > 0]))
    likely = [words for words, unit in CLOCKS_S.items() if WAITS[0] <= share * unit <= WAITS[1]]
    if likely and not WAITS[0] <= share <= WAITS[1]:
        rule = f"rows are {share:.2g} times as far apart as the drive needs at full speed: is it in {likely[0]}?"
        yield f"{data.file}: time_s: {rule}"


def _marker_poses(table: CsvTable) -> list[str]:
    """A sentence about tangents that have two components, which may be meant so or be a lost column."""
    missing = [name for name in TANGENT if name not in table.header]
    if len(missing) != 1:
        return []
    return [f"{table.file}: there is no {missing[0]}: tangents are taken for directions seen along {missing[0][1]}."]


def _left_out(robot: Robot, data: Measurements) -> list[str]:
    """One sentence per effect of the robot file that these data say too little for."""
    lacking = (
        (given.effect.name, given.effect.missing_columns(data.time_s, data.more)) for given in Chain.of(robot).acting
    )
    return [
        f"{data.file}: without a column {', '.join(missing)} the robot's {name} is left out."
        for name, missing in lacking
        if missing
    ]
