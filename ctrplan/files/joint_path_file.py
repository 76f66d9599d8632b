"""PATH.csv -> JointPath: base rotations and translations of every tube, row by row. Every fault is one sentence.

Columns, in any order: theta_1_rad ... theta_n_rad and l_1_m ... l_n_m, outermost tube first; optionally sequence (a run
that is approached afresh) and time_s. Others serve the effects that need them. Files of measurements are such paths as
well, read by the same rules. So is the trajectory.csv of a plan, whose columns are those of the drive's joints.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, are_degrees
from ctrplan.drive.drive import Drive
from ctrplan.files.mapping_file import Source, sources
from ctrplan.measurement.joint_path import JointPath, joined_paths, jumps, looks_wrapped, unwrapped
from ctrplan.robot.robot import Robot, nesting_violation
from ctrplan.storage.csv_table import CsvTable
from ctrplan.storage.toml_document import LARGEST_NUMBER

MOST_TURNS = 50  # of a tube; more are most likely degrees
LARGEST_RUN = 10**15  # numbers of runs beyond it are not exact
WHOLE_NUMBER = "must be a whole number of at most 15 digits"
MOST_LENGTHS = 10  # of the longest tube; more are most likely millimetres


def joint_columns(n: int) -> tuple[list[str], list[str]]:
    """Names of the columns of base rotations and base translations, outermost tube first."""
    tubes = range(1, n + 1)
    return [f"theta_{i}_rad" for i in tubes], [f"l_{i}_m" for i in tubes]


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
    _check_order(table, sequence, time_s)
    theta, notes = _whole_turns(source, theta, sequence.astype(int))
    if not source.is_mapped and are_degrees(theta):
        largest = float(np.abs(theta).max())
        whole = ", in whole numbers" if (theta == np.round(theta)).all() else ""
        notes += (f"{table.file}: rotations go to {largest:g} rad{whole}: are these degrees?",)
    _check_joints(table, theta, l, robot, of_collars=source.of_collars)
    read = {"sequence", "time_s", *rotations, *translations, *needed, *known}
    others = table.others(read)
    return JointPath(theta, l, sequence.astype(int), time_s, table.file, others, notes, source.of_collars)


def _whole_turns(source: Source, theta: Array, sequence: NDArray[np.int_]) -> tuple[Array, tuple[str, ...]]:
    """Rotations (R, n) without the jumps of wrapped angles, and a note for each tube that had some."""
    notes, whole = [], theta.copy()
    for i in range(theta.shape[1]):
        wrapped = looks_wrapped(theta[:, i], sequence) if source.wrapped is None else source.wrapped
        name, rows = f"theta_{i + 1}_rad", jumps(theta[:, i], sequence)
        if wrapped is None:
            turn = np.degrees(abs(theta[rows[0], i] - theta[rows[0] - 1, i]))
            rule = f"turns by {turn:.0f} deg at once: is it wrapped? Unwrap it, or give a row halfway if it is not"
            raise source.table.fault(rule, int(rows[0]), name, float(theta[rows[0], i]))
        if wrapped and len(rows):
            whole[:, i] = unwrapped(theta[:, i], sequence)
            notes.append(f"{source.table.file}: {name} is wrapped: {len(rows)} steps of nearly a turn were taken out.")
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


def _check_order(table: CsvTable, sequence: Array, time_s: Array | None) -> None:
    for row in np.flatnonzero((sequence != np.round(sequence)) | (np.abs(sequence) > LARGEST_RUN)).tolist():
        raise table.fault(WHOLE_NUMBER, row, "sequence", float(sequence[row]))
    if (resumed := _resumed_run(sequence)) is not None:
        rule = "this run was over, its rows must stand together"
        raise table.fault(rule, resumed, "sequence", int(sequence[resumed]))
    if time_s is not None:
        for row in np.flatnonzero(np.abs(time_s) > LARGEST_NUMBER).tolist():  # stamps in ns
            rule = f"must be from {-LARGEST_NUMBER:g} to {LARGEST_NUMBER:g} s"
            raise table.fault(rule, row, "time_s", float(time_s[row]))
        for row in (np.flatnonzero(np.diff(time_s) < 0) + 1).tolist():
            rule = f"time runs backwards, the row before has {time_s[row - 1]:g} s"
            raise table.fault(rule, row, "time_s", float(time_s[row]))


def _check_joints(table: CsvTable, theta: Array, l: Array, robot: Robot, *, of_collars: bool) -> None:  # noqa: E741
    """Commanded values; tubes nest as commanded or where the drive puts them."""
    rotations, translations = joint_columns(robot.n)
    longest_m = max(tube.length_m for tube in robot.tubes)
    for row, i in np.argwhere(np.abs(theta) > MOST_TURNS * 2 * np.pi).tolist():
        rule = f"is more than {MOST_TURNS} turns in rad, are these degrees?"
        raise table.fault(rule, row, rotations[i], float(theta[row, i]))
    for row, i in np.argwhere(np.abs(l) > MOST_LENGTHS * longest_m).tolist():
        rule = f"must be in metres and is beyond {MOST_LENGTHS} lengths of the robot, are these millimetres?"
        raise table.fault(rule, row, translations[i], float(l[row, i]))
    driven = (theta, l) if of_collars else robot.collars(theta, l)
    if refused := robot.mechanics.first_refused(theta, l) and robot.mechanics.first_refused(*driven):
        row, rule = refused
        sentence = nesting_violation(robot, driven[0][row], driven[1][row]) or rule.rstrip(".")
        hint = " (a tube that may be drawn back has retractable = true)" if "tips in order" in sentence else ""
        if (beyond := np.abs(l[row]) > longest_m).any():
            hint = f": is {translations[int(np.argmax(beyond))]} in millimetres?"
        raise table.fault(sentence + hint, row)


def _resumed_run(sequence: Array) -> int | None:
    """The first row (from 0) that goes back to a run which was over, None if there is none."""
    starts = np.flatnonzero(np.diff(sequence, prepend=np.nan) != 0)
    first = np.unique(sequence[starts], return_index=True)[1]
    again = np.setdiff1d(np.arange(len(starts)), first)
    return int(starts[again[0]]) if again.size else None
