"""measurements.csv -> Measurements. Every fault is one sentence with file, row, column, value and rule."""

from __future__ import annotations

import csv
import hashlib
import os
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from ctrplan.drive import Array
from ctrplan.errors import InputError
from ctrplan.file_bytes import file_bytes
from ctrplan.measurements import Measurements, is_streamed
from ctrplan.path_file import LARGEST_RUN, WHOLE_NUMBER, column_names, joint_columns, resumed_run
from ctrplan.robot import Robot

LARGEST_FILE_BYTES = 200_000_000
POSE = ("x_m", "y_m", "z_m", "tx", "ty", "tz")
TANGENT_TOLERANCE = 0.01  # of its length: files are rounded
MOST_TURNS = 50  # of a joint; more are most likely degrees
FURTHEST = 2.0  # tip from the base, in lengths of the longest tube
STILL_RAD, STILL_M = 1e-6, 1e-8


def load_measurements(path: str | os.PathLike[str], robot: Robot) -> Measurements:
    """The waypoints and poses of a CSV file that goes with `robot`.

    Raises InputError, one sentence with file, row, column, value and rule, for anything malformed or contradictory.
    """
    file = os.fspath(path)
    data = file_bytes(file, LARGEST_FILE_BYTES, "CSV", "file of measurements")
    return _Table(file, data).measurements(robot)


class _Table:
    """The cells of one file by column; rows are counted from 1 below the header, as a person would."""

    def __init__(self, file: str, data: bytes) -> None:
        self.file, self.sha256 = file, hashlib.sha256(data).hexdigest()
        try:
            lines = [row for row in csv.reader(data.decode("utf-8-sig").splitlines(), strict=True) if row]
        except UnicodeDecodeError as error:
            raise InputError(f"is not UTF-8 text (byte {error.start})", file=file) from None
        except csv.Error as error:
            raise InputError(f"is no readable CSV file ({error})", file=file) from None
        if len(lines) < 2:
            raise InputError("must have a header and at least one row", file=file)
        self.header = column_names(lines[0], file)
        self.lines = lines[1:]
        self._check_rows()

    def measurements(self, robot: Robot) -> Measurements:
        n = robot.n
        self._check_columns(n)
        rotations, translations = joint_columns(n)
        theta_b, l_b = (np.column_stack([self._column(name) for name in names]) for names in (rotations, translations))
        pose, rows = self._poses()
        sequence = self._column("sequence")
        time_s = self._column("time_s") if "time_s" in self.header else None
        self._check_order(sequence, time_s)
        self._check_joints(theta_b, l_b, robot)
        self._check_poses(pose, rows, robot)
        known = {"sequence", "time_s", *POSE, *rotations, *translations}
        tangent = pose[:, 3:] / np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
        return Measurements(
            sequence=sequence.astype(int),
            theta_b=theta_b,
            l_b=l_b,
            rows=rows,
            position_m=pose[:, :3],
            tangent=tangent,
            time_s=time_s,
            is_stream=is_streamed(sequence.astype(int), rows, np.hstack([theta_b, l_b])),
            more={
                name: self._column(name, empty=True)
                for name in self.header
                if name not in known and self._is_numeric(name)
            },
            file=self.file,
            sha256=self.sha256,
            warnings=tuple(_still_joints(theta_b[rows], l_b[rows], self.file)),
        )

    def fault(self, rule: str, row: int | None = None, column: str | None = None, value: Any = ...) -> InputError:
        """The error that a cell breaks `rule`; rows count from 0 here."""
        place = ", ".join(part for part in (None if row is None else f"row {row + 1}", column) if part)
        return InputError(rule, file=self.file, key=place or None, value=value)

    def _check_rows(self) -> None:
        for name, count in Counter(self.header).items():
            if count > 1:
                raise self.fault(f"the header has this column {count} times", column=name or "(no name)")
        for row, cells in enumerate(self.lines):
            if [cell.strip() for cell in cells] == self.header:
                raise self.fault("repeats the header, were files joined?", row)
            if len(cells) != len(self.header):
                raise self.fault(f"has {len(cells)} values, the header {len(self.header)}", row)

    def _check_columns(self, n: int) -> None:
        numbers = {int(m[1]) for name in self.header if (m := re.fullmatch(r"(?:theta|l)_(\d+)_\w+", name))}
        tubes = max(numbers, default=0)
        if tubes > n or 0 < tubes < n:
            raise self.fault(f"has joints of {tubes} tubes, the robot file has {n}", column="header")
        rotations, translations = joint_columns(n)
        for name in ("sequence", *rotations, *translations, *POSE):
            if name not in self.header:
                raise self.fault(self._missing(name), column=name)

    def _missing(self, name: str) -> str:
        stem = re.sub(r"_(?:rad|m)$", "", name)
        if other := [given for given in self.header if given == stem or re.fullmatch(rf"{stem}_[a-z]+", given)]:
            return f"is missing, found {other[0]}: columns are in rad and m"
        return "is missing"

    def _cell(self, row: int, name: str, empty: bool = False) -> float:
        text = self.lines[row][self.header.index(name)].strip()
        if empty and not text:
            return np.nan
        try:
            value = float(text)
        except ValueError:
            raise self.fault("must be a number", row, name, text) from None
        if not np.isfinite(value):
            raise self.fault("must be a finite number", row, name, text)
        return value

    def _column(self, name: str, empty: bool = False) -> Array:
        column = self.header.index(name)
        texts = [line[column].strip() for line in self.lines]
        try:
            numbers = np.array([float(text) if text else np.nan for text in texts])
        except ValueError:
            numbers = np.array([np.inf])
        given = np.array([bool(text) for text in texts])
        if len(numbers) == len(given) and np.isfinite(numbers[given]).all() and (empty or given.all()):
            return numbers
        return np.array([self._cell(row, name, empty) for row in range(len(self.lines))])

    def _is_numeric(self, name: str) -> bool:
        """Whether an extra column can be used for localising; notes and names cannot."""
        try:
            return bool(np.isfinite(self._column(name, empty=True)).any())
        except InputError:
            return False

    def _poses(self) -> tuple[Array, Any]:
        pose = np.column_stack([self._column(name, empty=True) for name in POSE])
        given = np.isfinite(pose)
        for row in np.flatnonzero(given.any(axis=1) & ~given.all(axis=1)).tolist():
            raise self.fault(
                "is empty, a pose needs all of x_m, y_m, z_m, tx, ty, tz", row, POSE[int(given[row].argmin())]
            )
        rows = np.flatnonzero(given.all(axis=1))
        if not len(rows):
            raise self.fault("holds no pose: x_m, y_m, z_m, tx, ty, tz are empty in every row")
        return pose[rows], rows

    def _check_order(self, sequence: Array, time_s: Array | None) -> None:
        for row in np.flatnonzero((sequence != np.round(sequence)) | (np.abs(sequence) > LARGEST_RUN)).tolist():
            raise self.fault(WHOLE_NUMBER, row, "sequence", sequence[row])
        if (resumed := resumed_run(sequence)) is not None:
            rule = "this run was over, its rows must stand together"
            raise self.fault(rule, resumed, "sequence", int(sequence[resumed]))
        if time_s is not None:
            for row in np.flatnonzero(np.diff(time_s) < 0).tolist():
                raise self.fault(
                    f"time runs backwards, the row before has {time_s[row]:g} s", row + 1, "time_s", time_s[row + 1]
                )

    def _check_joints(self, theta_b: Array, l_b: Array, robot: Robot) -> None:
        for row, i in np.argwhere(np.abs(theta_b) > MOST_TURNS * 2 * np.pi).tolist():
            raise self.fault(
                f"is more than {MOST_TURNS} turns, are these degrees?", row, f"theta_{i + 1}_rad", theta_b[row, i]
            )
        longest = max(tube.length_m for tube in robot.tubes)
        for row, i in np.argwhere(np.abs(l_b) > 10 * longest).tolist():
            raise self.fault("is far longer than the tube, are these millimetres?", row, f"l_{i + 1}_m", l_b[row, i])
        if refused := robot.mechanics.first_refused(theta_b, l_b):
            raise self.fault(refused[1].rstrip("."), refused[0])
        if np.ptp(theta_b, axis=0).max() < STILL_RAD and np.ptp(l_b, axis=0).max() < STILL_M:
            raise self.fault("all joints are constant: one configuration says nothing about a model")

    def _check_poses(self, pose: Array, rows: Sequence[int], robot: Robot) -> None:
        with np.errstate(over="ignore"):  # what is beyond all numbers is too far
            far, length = (np.linalg.norm(vectors, axis=1) for vectors in (pose[:, :3], pose[:, 3:]))
        limit = FURTHEST * max(tube.length_m for tube in robot.tubes)
        for k in np.flatnonzero(far > limit).tolist():
            unit = ", are these millimetres?" if np.median(far) > 100 * limit else ""
            rule = f"tip is {far[k]:g} m from the base, beyond the reach of {limit:.3g} m{unit}"
            raise self.fault(rule, int(rows[k]), "x_m", pose[k, 0])
        if np.median(far) < limit / 2000:
            raise self.fault(f"tips are {np.median(far):.2g} m from the base, are these metres?", column="x_m")
        for k in np.flatnonzero(np.abs(length - 1) > TANGENT_TOLERANCE).tolist():
            raise self.fault(
                f"tangent has length {length[k]:.4g}, must be a unit vector", int(rows[k]), "tx", pose[k, 3]
            )


def _still_joints(theta_b: Array, l_b: Array, file: str) -> list[str]:
    """One sentence per pair of tubes that never turned and per tube that never moved inside the others."""
    still = []
    for i in range(1, theta_b.shape[1]):
        if np.ptp(theta_b[:, i] - theta_b[:, i - 1]) < STILL_RAD:
            still.append(f"{file}: tubes {i} and {i + 1} never turn against each other: their pair is not testable.")
    if np.ptp(l_b, axis=0).max() < STILL_M:
        still.append(f"{file}: no tube is ever moved along: lengths and translations are not testable.")
    return still
