"""PATH.csv -> JointPath: base rotations and translations of every tube, row by row. Every fault is one sentence.

Columns, in any order: theta_1_rad ... theta_n_rad and l_1_m ... l_n_m, outermost tube first; optionally sequence (a run
that is approached afresh) and time_s. Others, such as measured poses, are left alone.
"""

from __future__ import annotations

import csv
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.drive import Array
from ctrplan.errors import InputError
from ctrplan.file_bytes import file_bytes
from ctrplan.nesting import TOLERANCE_M, nesting_inequalities, nesting_violation
from ctrplan.robot import Robot

LARGEST_FILE_BYTES = 200_000_000
MOST_TURNS = 50  # of a tube; more are most likely degrees
LARGEST_RUN = 10**15  # numbers of runs beyond it are not exact
WHOLE_NUMBER = "must be a whole number of at most 15 digits"
MOST_LENGTHS = 10  # of the longest tube; more are most likely millimetres


@dataclass(frozen=True, eq=False)
class JointPath:
    """K waypoints of n tubes in the order visited; between them all joints move together linearly."""

    theta_b: Array  # (K, n) base rotations, rad, not wrapped
    l_b: Array  # (K, n) base translations, m
    sequence: NDArray[np.int_]  # (K,) runs, each approached afresh
    time_s: Array | None = None  # (K,)
    file: str | None = None

    @property
    def runs(self) -> list[slice]:
        """Rows of each run."""
        starts = [*np.flatnonzero(np.diff(self.sequence, prepend=np.nan) != 0).tolist(), len(self.sequence)]
        return [slice(a, b) for a, b in zip(starts, starts[1:], strict=False)]


def joint_columns(n: int) -> tuple[list[str], list[str]]:
    """Names of the columns of base rotations and base translations, outermost tube first."""
    tubes = range(1, n + 1)
    return [f"theta_{i}_rad" for i in tubes], [f"l_{i}_m" for i in tubes]


def load_joint_path(path: str | os.PathLike[str], robot: Robot) -> JointPath:
    """The waypoints of a CSV file that goes with `robot`; InputError for anything malformed or contradictory."""
    table = CsvTable(os.fspath(path))
    rotations, translations = joint_columns(robot.n)
    for name in (*rotations, *translations):
        _require(table, name, robot.n)
    theta_b = np.column_stack([table.numbers(name) for name in rotations])
    l_b = np.column_stack([table.numbers(name) for name in translations])
    sequence = table.numbers("sequence") if "sequence" in table.header else np.zeros(len(theta_b))
    time_s = table.numbers("time_s") if "time_s" in table.header else None
    _check_order(table, sequence, time_s)
    _check_joints(table, theta_b, l_b, robot)
    return JointPath(theta_b, l_b, sequence.astype(int), time_s, table.file)


class CsvTable:
    """Cells of a CSV file by column name; rows are counted from 1 below the header, as a person would."""

    def __init__(self, file: str) -> None:
        """Reads the whole file. Raises InputError unless it is a table: readable, one header, all rows as long."""
        self.file = file
        try:
            lines = [row for row in csv.reader(_text(file).splitlines(), strict=True) if any(map(str.strip, row))]
        except csv.Error as error:
            raise InputError(f"is no readable CSV file ({error})", file=file) from None
        if len(lines) < 2:
            raise InputError("must have a header and at least one row", file=file)
        self.header = column_names(lines[0], file)
        self.rows = lines[1:]
        for name, count in Counter(self.header).items():
            if count > 1:
                raise InputError(f"the header has this column {count} times", file=file, key=name or "(no name)")
        for row, cells in enumerate(self.rows):
            if len(cells) != len(self.header):
                raise self.fault(f"has {len(cells)} values, the header has {len(self.header)} columns", row)

    def fault(self, rule: str, row: int, column: str | None = None, value: object = ...) -> InputError:
        """The error that row `row` (from 0) breaks `rule`."""
        return InputError(rule, file=self.file, key=f"row {row + 1}" + (f", {column}" if column else ""), value=value)

    def numbers(self, name: str) -> Array:
        """(K,) finite numbers of a column."""
        column = self.header.index(name)
        try:
            numbers = np.array([float(cells[column]) for cells in self.rows])
        except ValueError:
            numbers = np.array([np.nan])
        if np.isfinite(numbers).all():
            return numbers
        return np.array([self._number(row, name, cells[column].strip()) for row, cells in enumerate(self.rows)])

    def _number(self, row: int, name: str, text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise self.fault("must be a number", row, name, text) from None
        if not np.isfinite(value):
            raise self.fault("must be a finite number", row, name, text)
        return value


def _text(file: str) -> str:
    data = file_bytes(file, LARGEST_FILE_BYTES, "CSV", "joint path")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 text (byte {error.start})", file=file) from None


def _require(table: CsvTable, name: str, n: int) -> None:
    if name not in table.header:
        stem = re.sub(r"_(rad|m)$", "", name)
        other = [given for given in table.header if re.fullmatch(rf"{stem}(_[a-z]+)?", given)]
        found = f", found {other[0]}: rotations are in rad, translations in m" if other else ""
        raise InputError(f"this column is missing{found}", file=table.file, key=name)
    extra = [given for given in table.header if re.fullmatch(rf"(theta|l)_{n + 1}_\w+", given)]
    if extra:
        raise InputError(f"the robot has only {n} {'tube' if n == 1 else 'tubes'}", file=table.file, key=extra[0])


def column_names(header: Sequence[str], file: str) -> list[str]:
    """Names of the columns. Raises InputError where something else than a comma stands between them."""
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise InputError(f"has its columns separated by {name}, must be commas", file=file)
    return [name.strip() for name in header]


def resumed_run(sequence: Array) -> int | None:
    """The first row (from 0) that goes back to a run which was over, None if there is none."""
    starts = np.flatnonzero(np.diff(sequence, prepend=np.nan) != 0)
    first = np.unique(sequence[starts], return_index=True)[1]
    again = np.setdiff1d(np.arange(len(starts)), first)
    return int(starts[again[0]]) if again.size else None


def _check_order(table: CsvTable, sequence: Array, time_s: Array | None) -> None:
    for row in np.flatnonzero((sequence != np.round(sequence)) | (np.abs(sequence) > LARGEST_RUN)).tolist():
        raise table.fault(WHOLE_NUMBER, row, "sequence", float(sequence[row]))
    if (resumed := resumed_run(sequence)) is not None:
        rule = "this run was over, its rows must stand together"
        raise table.fault(rule, resumed, "sequence", int(sequence[resumed]))
    if time_s is not None:
        for row in (np.flatnonzero(np.diff(time_s) < 0) + 1).tolist():
            rule = f"time runs backwards, the row before has {time_s[row - 1]:g} s"
            raise table.fault(rule, row, "time_s", float(time_s[row]))


def _check_joints(table: CsvTable, theta_b: Array, l_b: Array, robot: Robot) -> None:
    rotations, translations = joint_columns(robot.n)
    longest_m = max(tube.length_m for tube in robot.tubes)
    for row, i in np.argwhere(np.abs(theta_b) > MOST_TURNS * 2 * np.pi).tolist():
        rule = f"is more than {MOST_TURNS} turns in rad, are these degrees?"
        raise table.fault(rule, row, rotations[i], float(theta_b[row, i]))
    for row, i in np.argwhere(np.abs(l_b) > MOST_LENGTHS * longest_m).tolist():
        rule = f"must be in metres and is beyond {MOST_LENGTHS} lengths of the robot, are these millimetres?"
        raise table.fault(rule, row, translations[i], float(l_b[row, i]))
    G, h = nesting_inequalities(robot.tubes)
    for row in np.flatnonzero(~np.all(l_b @ G.T <= h + TOLERANCE_M, axis=1)).tolist():
        if sentence := nesting_violation(robot, theta_b[row], l_b[row]):
            raise table.fault(sentence, row)
    if refused := robot.mechanics.first_refused(theta_b, l_b):
        raise table.fault(refused[1].rstrip("."), refused[0])
