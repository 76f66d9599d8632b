"""Tables of joints and poses -> JointPath, Measurements. Every fault is one sentence: file, row, column, value, rule.

Columns, in any order: theta_1_rad ... theta_n_rad and l_1_m ... l_n_m, outermost tube first; optionally sequence (a run
that is approached afresh) and time_s; poses where these were measured. Others serve the effects that need them. A
mapping file says where they are. The trajectory.csv of a plan, with the columns of the drive's joints, is a path too.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, are_degrees
from ctrplan.drive.drive import Drive
from ctrplan.drive.legs import STILL_M, STILL_RAD
from ctrplan.files.mapping_file import Source, sources
from ctrplan.measurement.joint_path import (
    JointPath,
    joined_measurements,
    joined_paths,
    jumps,
    looks_wrapped,
    unwrapped,
)
from ctrplan.measurement.measurements import POSITION, TANGENT, Measurements, is_streamed, joint_columns
from ctrplan.pipeline.chain import Chain
from ctrplan.pipeline.tip_table import registered
from ctrplan.robot.data_rules import check_joints, check_order, check_positions, passed, require_seen, unit_tangents
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

    def of(self, poses: NDArray[np.bool_]) -> MarkerColumns:
        """Some of its rows, mask (N,)."""
        return replace(self, position_m=self.position_m[poses], rows=self.rows[poses])


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


def played_columns(drive: Drive) -> list[str]:
    """Names of the columns of a plan's trajectory.csv with the positions of the drive's joints."""
    kinds = zip(drive.names, drive.is_rotation.tolist(), strict=True)
    return [f"{'_'.join(name.split())}_position_{'rad' if rotates else 'm'}" for name, rotates in kinds]


def load_joint_path(path: str | os.PathLike[str], robot: Robot) -> JointPath:
    """The waypoints of a CSV or mapping file that goes with `robot`; InputError for what is malformed."""
    return joined_paths([joint_path(source, robot) for source in sources(path, robot, "joint path")])


def joint_path(source: Source, robot: Robot, needed: Sequence[str] = (), known: Sequence[str] = ()) -> JointPath:
    """The waypoints of `robot` in a table, checked; `needed` are columns that must be there besides, `known` may be."""
    table = source.table
    rotations, translations = joint_columns(robot.n)
    played = played_columns(robot.drive)
    if rotations[0] not in table.header and all(name in table.header for name in played):  # trajectory.csv of a plan
        theta, l = robot.drive.commanded(table.columns(played))  # noqa: E741
        _check_columns(table, robot.n, needed)
        known = (*known, *table.header)
    else:
        _check_columns(table, robot.n, (*rotations, *translations, *needed))
        theta, l = table.columns(rotations), table.columns(translations)  # noqa: E741 (as in the equations)
    sequence = table.numbers("sequence") if "sequence" in table.header else np.zeros(len(theta))
    time_s = table.numbers("time_s") if "time_s" in table.header else None
    check_order(table, sequence, time_s)
    theta, notes = _whole_turns(source, theta, sequence.astype(int))
    if not source.is_mapped and are_degrees(theta):
        largest = float(np.abs(theta).max())
        whole = ", in whole numbers" if (theta == np.round(theta)).all() else ""
        notes += (f"{table.file}: rotations go to {largest:g} rad{whole}: are these degrees?",)
    check_joints(table, theta, l, robot, of_collars=source.of_collars)
    read = {"sequence", "time_s", *rotations, *translations, *needed, *known}
    others, unread = table.others(read)
    notes += tuple(unread)
    return JointPath(theta, l, sequence.astype(int), time_s, table.file, others, notes, source.of_collars)


def _whole_turns(source: Source, theta: Array, sequence: NDArray[np.int_]) -> tuple[Array, tuple[str, ...]]:
    """Rotations (R, n) without the jumps of wrapped angles, and a note for each tube that had some."""
    notes, whole = [], theta.copy()
    for i in range(theta.shape[1]):
        wrapped = looks_wrapped(theta[:, i], sequence) if source.wrapped is None else source.wrapped
        name, rows = f"theta_{i + 1}_rad", jumps(theta[:, i], sequence)
        if wrapped is None:
            turn = np.degrees(abs(theta[rows[0], i] - theta[rows[0] - 1, i]))
            rule = f"turns by {turn:.0f} deg at once: is it wrapped? Unwrap it, or give a row halfway if it is not; "
            rule += 'in a mapping file rotations = "wrapped" or "unwrapped" says which'
            raise source.table.fault(rule, int(rows[0]), name, float(theta[rows[0], i]))
        if wrapped and len(rows):
            whole[:, i] = unwrapped(theta[:, i], sequence)
            shown = source.table.names.get(name, name)
            notes.append(f"{source.table.file}: {shown} is wrapped: {len(rows)} steps of nearly a turn were taken out.")
    return whole, tuple(notes)


def _check_columns(table: CsvTable, n: int, needed: Sequence[str]) -> None:
    numbers = {int(m[1]) for name in table.header if (m := re.fullmatch(r"(?:theta|l)_([0-9]{1,9})_\w+", name))}
    tubes = max(numbers, default=0)
    if tubes > n or 0 < tubes < n:
        raise table.fault(f"has joints of {tubes} tubes, the robot file has {n}", column="header")
    for name in needed:
        if name not in table.header:
            stem = re.sub(r"_(?:rad|m)$", "", name)
            other = [given for given in table.header if re.fullmatch(rf"{stem}(_[a-z]+)?", given)]
            result = f", found {other[0]}: columns are in rad and m" if other else _nearest(name, table.header)
            raise table.fault(f"is missing{result}", column=name)


KNOWN = re.compile(r"(?:theta_\d+_rad|l_\d+_m|[xyz]_m|t[xyz]|sequence|time_s)")  # columns that are called so


LONGEST_NAME = 40  # letters of a column's name in a sentence


def _nearest(name: str, header: Sequence[str]) -> str:
    """The columns that there are, and the one most like the missing one."""
    short = [given if len(given) <= LONGEST_NAME else f"{given[:LONGEST_NAME]}..." for given in header[:20]]
    shown = ", ".join(short) + (" ..." if len(header) > 20 else "")
    others = [given for given in header if not KNOWN.fullmatch(given)]
    axis = re.fullmatch(r"t?([xyz])(?:_m)?", name)
    same = [given for given in others if axis and re.fullmatch(rf".*[_. ]{axis[1]}|{axis[1]}[_. ].*", given, re.I)]
    lower = {given.lower(): given for given in reversed(others)}
    close = same or [lower[key] for key in difflib.get_close_matches(name, lower, n=1, cutoff=0.5)]
    meant = f" (is {close[0][:LONGEST_NAME]} meant?)" if close else ""
    return f"{meant}: the columns are {shown}; a mapping file says what each of them is (ctrplan init mapping)"


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
    return passed(robot, replace(data, warnings=(*data.warnings, *more)))


def _measurements(source: Source, robot: Robot) -> Measurements:
    """One table's."""
    table = source.table
    seen = marker_columns(table, robot, is_registered=source.is_registered)
    bare = bool(seen) and not any(name in table.header for name in (*POSITION, *TANGENT))  # of markers alone
    known = (*TANGENT, *(name for point in seen for name in point.columns))
    joints = joint_path(source, robot, needed=("sequence", *(() if bare else POSITION)), known=known)
    position, tangent, rows = (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int)) if bare else _poses(table, seen)
    check_positions(table, position, rows, POSITION, robot, anywhere=not source.is_registered)
    for point in seen:
        check_positions(table, point.position_m, point.rows, point.columns, robot, anywhere=not source.is_registered)
    anew = _measured_anew(joints, rows, np.hstack([position, tangent]))
    seen = [point.of(_measured_anew(joints, point.rows, point.position_m)) for point in seen]
    position, tangent, rows, marker = with_markers(position[anew], tangent[anew], rows[anew], seen)
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
        warnings=(
            *joints.notes,
            *_copied_rows(table, ~anew),
            *_marker_poses(table),
            *(note for point in seen for note in point.notes),
        ),
        of_collars=joints.of_collars,
        marker=marker if seen else None,
        noise_ratio=noise_ratio(robot, marker),
        columns=table.names,
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
    require_seen(table, pose[rows, :3], rows, POSITION)
    tangent = np.full((len(rows), 3), np.nan)
    if seen:
        tangent[:, [TANGENT.index(name) for name in seen]] = unit_tangents(table, pose[rows, 3:], rows, seen)
    return pose[rows, :3], tangent, rows


def _measured_anew(joints: JointPath, rows: NDArray[np.int_], pose: Array) -> NDArray[np.bool_]:
    """(K,) poses (K, M) that are not those of the row before, written twice: time, joints and pose are its own."""
    time_s = np.zeros(len(joints.sequence)) if joints.time_s is None else joints.time_s
    whole = np.column_stack([joints.sequence, time_s, joints.theta_commanded, joints.l_commanded])[rows]
    whole = np.nan_to_num(np.hstack([whole, pose]))
    copied = (np.diff(rows) == 1) & (np.diff(whole, axis=0) == 0).all(axis=1)
    return np.concatenate([np.ones(min(1, len(rows)), bool), ~copied])


def _copied_rows(table: CsvTable, copied: NDArray[np.bool_]) -> list[str]:
    """A sentence about poses that stand in the file twice, if any do."""
    count = int(copied.sum())
    return [f"{table.file}: {count} rows repeat the row before to the last digit: they count once."] if count else []


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
        yield f"{data.file}: {data.columns.get('time_s', 'time_s')}: {rule}"


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
