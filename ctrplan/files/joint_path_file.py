"""PATH.csv -> JointPath: base rotations and translations of every tube, row by row. Every fault is one sentence.

Columns, in any order: theta_1_rad ... theta_n_rad and l_1_m ... l_n_m, outermost tube first; optionally sequence (a run
that is approached afresh) and time_s. Others serve the effects that need them. Files of measurements are such paths as
well: `CsvTable` reads both by the same rules.
"""

from __future__ import annotations

import csv
import hashlib
import os
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.experiment.joint_path import JointPath
from ctrplan.robot.nesting import nesting_violation
from ctrplan.robot.robot import Robot
from ctrplan.storage.file_bytes import file_bytes

LARGEST_FILE_BYTES = 200_000_000
MOST_TURNS = 50  # of a tube; more are most likely degrees
LARGEST_RUN = 10**15  # numbers of runs beyond it are not exact
WHOLE_NUMBER = "must be a whole number of at most 15 digits"
MOST_LENGTHS = 10  # of the longest tube; more are most likely millimetres


def joint_columns(n: int) -> tuple[list[str], list[str]]:
    """Names of the columns of base rotations and base translations, outermost tube first."""
    tubes = range(1, n + 1)
    return [f"theta_{i}_rad" for i in tubes], [f"l_{i}_m" for i in tubes]


def load_joint_path(path: str | os.PathLike[str], robot: Robot) -> JointPath:
    """The waypoints of a CSV file that goes with `robot`; InputError for anything malformed or contradictory."""
    return CsvTable(os.fspath(path), "joint path").joint_path(robot)


class CsvTable:
    """Cells of a CSV file by column name; rows are counted from 1 below the header, as a person would.

    Blank rows, of commas alone too, are none.
    """

    def __init__(self, file: str, what: str) -> None:
        """Reads the whole file, which is a `what`.

        Raises InputError unless it is a table: readable, one header, all rows as long.
        """
        data = file_bytes(file, LARGEST_FILE_BYTES, "CSV", what)
        self.file, self.sha256 = file, hashlib.sha256(data).hexdigest()
        try:
            lines = csv.reader(data.decode("utf-8-sig").splitlines(), strict=True)
            filled = [row for row in lines if any(map(str.strip, row))]
        except UnicodeDecodeError as error:
            raise InputError(f"is not UTF-8 text (byte {error.start})", file=file) from None
        except csv.Error as error:
            raise InputError(f"is no readable CSV file ({error})", file=file) from None
        if len(filled) < 2:
            raise InputError("must have a header and at least one row", file=file)
        self.header = _column_names(filled[0], file)
        self.rows = filled[1:]
        for name, count in Counter(self.header).items():
            if count > 1:
                raise self.fault(f"the header has this column {count} times", column=name or "(no name)")
        for row, cells in enumerate(self.rows):
            if [cell.strip() for cell in cells] == self.header:
                raise self.fault("repeats the header, were files joined?", row)
            if len(cells) != len(self.header):
                raise self.fault(f"has {len(cells)} values, the header has {len(self.header)} columns", row)

    def fault(self, rule: str, row: int | None = None, column: str | None = None, value: object = ...) -> InputError:
        """The error that a cell, row (from 0) or column breaks `rule`."""
        place = ", ".join(part for part in (None if row is None else f"row {row + 1}", column) if part)
        return InputError(rule, file=self.file, key=place or None, value=value)

    def numbers(self, name: str, *, blanks: bool = False) -> Array:
        """(K,) finite numbers of a column; with `blanks` NaN where nothing stands."""
        column = self.header.index(name)
        texts = [cells[column].strip() for cells in self.rows]
        given = np.array([bool(text) for text in texts])
        if blanks or given.all():
            with suppress(ValueError):  # what is wrong is looked for below
                found = np.array([float(text) if text else np.nan for text in texts])
                if np.isfinite(found[given]).all():
                    return found
        return np.array([self._number(row, name, text, blanks) for row, text in enumerate(texts)])

    def joint_path(self, robot: Robot, needed: Sequence[str] = ()) -> JointPath:
        """The waypoints of `robot`, checked; `needed` are columns that must be there besides."""
        rotations, translations = joint_columns(robot.n)
        self._check_columns(robot.n, (*rotations, *translations, *needed))
        theta_b = np.column_stack([self.numbers(name) for name in rotations])
        l_b = np.column_stack([self.numbers(name) for name in translations])
        sequence = self.numbers("sequence") if "sequence" in self.header else np.zeros(len(theta_b))
        time_s = self.numbers("time_s") if "time_s" in self.header else None
        self._check_order(sequence, time_s)
        self._check_joints(theta_b, l_b, robot)
        known = {"sequence", "time_s", *rotations, *translations, *needed}
        return JointPath(theta_b, l_b, sequence.astype(int), time_s, self.file, self._others(known))

    def _number(self, row: int, name: str, text: str, blanks: bool) -> float:
        if blanks and not text:
            return np.nan
        try:
            value = float(text)
        except ValueError:
            raise self.fault("must be a number", row, name, text) from None
        if not np.isfinite(value):
            raise self.fault("must be a finite number", row, name, text)
        return value

    def _others(self, known: set[str]) -> dict[str, Array]:
        """Numeric columns besides the known ones; notes and names are none."""
        found = {}
        for name in self.header:
            if name not in known:
                with suppress(InputError):
                    found[name] = self.numbers(name, blanks=True)
        return {name: values for name, values in found.items() if np.isfinite(values).any()}

    def _check_columns(self, n: int, needed: Sequence[str]) -> None:
        numbers = {int(m[1]) for name in self.header if (m := re.fullmatch(r"(?:theta|l)_(\d+)_\w+", name))}
        tubes = max(numbers, default=0)
        if tubes > n or 0 < tubes < n:
            raise self.fault(f"has joints of {tubes} tubes, the robot file has {n}", column="header")
        for name in needed:
            if name not in self.header:
                stem = re.sub(r"_(?:rad|m)$", "", name)
                other = [given for given in self.header if re.fullmatch(rf"{stem}(_[a-z]+)?", given)]
                found = f", found {other[0]}: columns are in rad and m" if other else ""
                raise self.fault(f"is missing{found}", column=name)

    def _check_order(self, sequence: Array, time_s: Array | None) -> None:
        for row in np.flatnonzero((sequence != np.round(sequence)) | (np.abs(sequence) > LARGEST_RUN)).tolist():
            raise self.fault(WHOLE_NUMBER, row, "sequence", float(sequence[row]))
        if (resumed := _resumed_run(sequence)) is not None:
            rule = "this run was over, its rows must stand together"
            raise self.fault(rule, resumed, "sequence", int(sequence[resumed]))
        if time_s is not None:
            for row in (np.flatnonzero(np.diff(time_s) < 0) + 1).tolist():
                rule = f"time runs backwards, the row before has {time_s[row - 1]:g} s"
                raise self.fault(rule, row, "time_s", float(time_s[row]))

    def _check_joints(self, theta_b: Array, l_b: Array, robot: Robot) -> None:
        rotations, translations = joint_columns(robot.n)
        longest_m = max(tube.length_m for tube in robot.tubes)
        for row, i in np.argwhere(np.abs(theta_b) > MOST_TURNS * 2 * np.pi).tolist():
            rule = f"is more than {MOST_TURNS} turns in rad, are these degrees?"
            raise self.fault(rule, row, rotations[i], float(theta_b[row, i]))
        for row, i in np.argwhere(np.abs(l_b) > MOST_LENGTHS * longest_m).tolist():
            rule = f"must be in metres and is beyond {MOST_LENGTHS} lengths of the robot, are these millimetres?"
            raise self.fault(rule, row, translations[i], float(l_b[row, i]))
        if refused := robot.mechanics.first_refused(theta_b, l_b):
            row, rule = refused
            raise self.fault(nesting_violation(robot, theta_b[row], l_b[row]) or rule.rstrip("."), row)


def _column_names(header: Sequence[str], file: str) -> list[str]:
    """Names of the columns. Raises InputError where something else than a comma stands between them."""
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise InputError(f"has its columns separated by {name}, must be commas", file=file)
    return [name.strip() for name in header]


def _resumed_run(sequence: Array) -> int | None:
    """The first row (from 0) that goes back to a run which was over, None if there is none."""
    starts = np.flatnonzero(np.diff(sequence, prepend=np.nan) != 0)
    first = np.unique(sequence[starts], return_index=True)[1]
    again = np.setdiff1d(np.arange(len(starts)), first)
    return int(starts[again[0]]) if again.size else None
