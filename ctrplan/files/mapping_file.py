"""Mapping files: a laboratory's own tables under the names and in the units that ctrplan reads.

Faults name the laboratory's file, row and column.

What reads joints or poses, `measurement_file.py`, asks here.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct

from ctrplan.base.arrays import NORM_TOLERANCE, Array
from ctrplan.errors import InputError
from ctrplan.files.ros_bag import TIP, BagTable, is_bag
from ctrplan.measurement.measurements import POSITION, TANGENT
from ctrplan.robot.robot import Robot
from ctrplan.storage.csv_table import CsvTable, file_name
from ctrplan.storage.toml_document import (
    Angle,
    Coordinate,
    Document,
    Name,
    Point,
    file_inside,
    path_inside,
    read_document,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

MOST_RUNS = 200

Column = str | int  # its name, or its number from 1 where there is no header; -NAME changes its sign
Columns = list[Column]
Three = Annotated[list[Column], Meta(min_length=3, max_length=3)]
Quaternion = tuple[float, float, float, float]


class FrameEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """frame = {...}: the robot's frame in that of the tracker."""

    position_mm: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


class RunEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[[run]]: a file, or one of joints and one of poses whose rows belong together."""

    file: str | None = None
    joints: str | None = None
    poses: str | None = None
    tracker: Name = "tracker"  # runs of one name share its frame
    homing: Name = "homing"  # runs of one name share the zeros of the joints
    frame: FrameEntry | Literal["unknown"] | None = None


class ColumnsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[columns]: of both files of a run counted on, those of the poses after those of the joints."""

    position: Three | None = None  # of the tip
    markers: dict[str, Three] = {}  # marker of the robot -> columns, "" along the line of sight
    theta: Columns | None = None
    l: Columns | None = None  # noqa: E741 (as in the equations)
    joints: dict[str, Column] | None = None  # actuator -> column, in place of theta and l
    tangent: Three | None = None  # "" where a component is not seen
    time: Column | None = None
    sequence: Column | None = None
    more: dict[str, Column] = {}


class UnitsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[units]"""

    theta: Literal["rad", "deg", "turns"] = "rad"
    l: Literal["m", "mm"] = "m"  # noqa: E741
    position: Literal["m", "mm"] = "m"
    time: Literal["s", "ms", "us", "ns"] = "s"


class ZeroEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[zero]: what is added to the values of the tubes, in the order of the lists."""

    theta_deg: list[Angle] | None = None
    l_mm: list[Coordinate] | None = None


class BagEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[bag]: topics of recordings of ROS."""

    joints: str = "/joint_states"
    poses: str = "/tip"
    frame: str = ""  # the child of tf that is the tip


class MappingEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """A mapping file."""

    run: Annotated[list[RunEntry], Meta(min_length=1, max_length=MOST_RUNS)]
    columns: ColumnsEntry
    units: UnitsEntry = UnitsEntry()
    zero: ZeroEntry = ZeroEntry()
    bag: BagEntry = BagEntry()
    tubes: Literal["outermost first", "innermost first"] = "outermost first"
    values: Literal["commanded", "collars"] = "commanded"
    rotations: Literal["unwrapped", "wrapped"] | None = None
    at_rest: bool | None = None
    separator: Literal[",", ";", "tab", "space"] = ","
    header: bool = True


SEPARATORS = {",": ",", ";": ";", "tab": "\t", "space": " "}
SI = {"rad": 1.0, "deg": math.pi / 180, "turns": 2 * math.pi, "m": 1.0, "mm": 1e-3}
SI |= {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True)
class Cells:
    """Where a column of ctrplan's stands."""

    table: CsvTable
    name: str
    factor: float  # from the file's unit and sign to SI


class MappedTable(CsvTable):
    """One run of a mapping file; columns that are computed from others are numbers alone."""

    def __init__(self, entry: MappingEntry, k: int, robot: Robot, document: Document) -> None:
        """The k-th run (from 0) of a mapping file for `robot`. Raises InputError for what does not fit together."""
        self._entry, self._place, self._document = entry, ("run", k), document
        self._joints, self._poses = self._tables(entry.run[k])
        self.file = self._joints.file
        self.sha256 = hashlib.sha256((self._joints.sha256 + self._poses.sha256).encode()).hexdigest()
        self.rows = self._joints.rows
        self._columns = entry.columns
        if isinstance(self._joints, BagTable):  # whose columns have names of their own
            given = entry.columns
            time, position = given.time or "time", given.position or (None if given.markers else list(TIP[:3]))
            self._columns = msgspec.structs.replace(given, time=time, position=position)
        self._cells: dict[str, Cells] = {}
        self._numbers: dict[str, Array] = {}
        self.names = {}
        self._add_joints(robot)
        self._add_poses(robot, entry.run[k].frame)
        units = entry.units
        if self._columns.time is not None:
            self._cells["time_s"] = self._cell(self._columns.time, SI[units.time], "time")
        if entry.columns.sequence is not None:
            self._cells["sequence"] = self._cell(entry.columns.sequence, 1.0, "sequence")
        else:
            self._numbers["sequence"] = np.zeros(len(self.rows))
        for name, column in entry.columns.more.items():
            self._cells[name] = self._cell(column, 1.0, "more", name)
        self.header = [*self._cells, *self._numbers]
        self.names |= {name: cells.name for name, cells in self._cells.items()}

    def numbers(self, name: str, *, blanks: bool = False) -> Array:
        """(K,) numbers of a column in SI, as `CsvTable.numbers`."""
        if name in self._numbers:
            return self._numbers[name]
        cells = self._cells[name]
        return cells.factor * cells.table.numbers(cells.name, blanks=blanks)

    def fault(self, rule: str, row: int | None = None, column: str | None = None, value: object = ...) -> InputError:
        """The error that a cell breaks `rule`, by the name that the column has in its own file."""
        if column not in self._cells:
            return CsvTable.fault(self._joints, rule, row, column, value)
        cells = self._cells[column]
        return CsvTable.fault(cells.table, rule, row, f"{cells.name} ({column})", value)

    def _tables(self, run: RunEntry) -> tuple[CsvTable, CsvTable]:
        if (run.file is None) == (run.joints is None) or (run.joints is None) != (run.poses is None):
            raise self._document.fault("must have file, or joints and poses", *self._place)
        names = {"file": run.file} if run.file is not None else {"joints": run.joints, "poses": run.poses}
        tables = [self._table(str(name), key) for key, name in names.items()]
        first, last = tables[0], tables[-1]
        if len(first.rows) != len(last.rows):
            rule = f"has {len(last.rows)} rows, must have one for each of the {len(first.rows)} of {first.file}"
            raise InputError(rule, file=last.file)
        return first, last

    def _table(self, name: str, key: str) -> CsvTable:
        path: Path = path_inside(name, self._document, *self._place, key)
        if key == "file" and is_bag(path):
            bag = self._entry.bag
            return BagTable(path, bag.joints, bag.poses, bag.frame)
        path = file_inside(name, self._document, None, *self._place, key)
        separator = SEPARATORS[self._entry.separator]
        return CsvTable(str(path), "file of measurements", separator=separator, header=self._entry.header)

    def _cell(self, column: Column, factor: float, *path: str | int, poses: bool = False) -> Cells:
        """The cells that a column of the mapping file stands for; joints.NAME and poses.NAME say in which file."""
        name, sign = str(column), 1.0
        table = self._poses if poses else self._joints
        if name not in table.header and name.startswith("-"):
            name, sign = name[1:], -1.0
        place, dot, rest = name.partition(".")
        if name not in table.header and dot and place in ("joints", "poses"):
            table, name = (self._joints if place == "joints" else self._poses), rest
        if name not in table.header:
            known = ", ".join(table.header[:20]) + (" ..." if len(table.header) > 20 else "")
            raise self._document.fault(f"is no column of {table.file}, which has {known}", "columns", *path)
        return Cells(table, name, sign * factor)

    def _add_joints(self, robot: Robot) -> None:
        columns, units = self._entry.columns, self._entry.units
        if columns.joints is not None:
            if columns.theta is not None or columns.l is not None:
                raise self._document.fault("and theta or l exclude each other", "columns", "joints")
            return self._add_actuators(columns.joints, robot)
        for key, stem, unit in (("theta", "theta_{}_rad", units.theta), ("l", "l_{}_m", units.l)):
            given: list[Column] | None = getattr(columns, key)
            if given is None or len(given) != robot.n:
                count = "is missing" if given is None else f"has {len(given)} columns"
                raise self._document.fault(f"{count}, must have one for each of {robot.n} tubes", "columns", key)
            for k, column in enumerate(given):
                self._add_tube(stem.format(self._tube(k, robot.n)), k, column, SI[unit], key, robot.n)

    def _tube(self, k: int, n: int) -> int:
        """Number, from 1, outermost first, of the k-th tube of the lists."""
        return k + 1 if self._entry.tubes == "outermost first" else n - k

    def _add_tube(self, name: str, k: int, column: Column, factor: float, key: str, n: int) -> None:
        zero_key, unit = ("theta_deg", "deg") if key == "theta" else ("l_mm", "mm")
        zeros: Sequence[float] | None = getattr(self._entry.zero, zero_key)
        if zeros is not None and len(zeros) != n:
            raise self._document.fault(f"must have one value for each of {n} tubes", "zero", zero_key)
        cells = self._cell(column, factor, key, k)
        self._cells[name] = cells
        if zeros is not None:
            self._numbers[name] = self.numbers(name) + SI[unit] * zeros[k]
            self.names[name] = self._cells.pop(name).name

    def _add_actuators(self, columns: Mapping[str, Column], robot: Robot) -> None:
        """The drive's own values, by the names of its joints."""
        drive, units = robot.drive, self._entry.units
        for name in (*drive.names, *columns):
            if name not in columns or name not in drive.names:
                rule = f"must name the joints of the robot: {', '.join(drive.names)}"
                raise self._document.fault(rule, "columns", "joints", *([name] if name in columns else []))
        values = []
        for joint in drive.joints:
            unit = units.theta if joint.kind == "rotation" else units.l
            cells = self._cell(columns[joint.name], SI[unit], "joints", joint.name)
            values.append(cells.factor * cells.table.numbers(cells.name))
        theta, l = drive.commanded(np.column_stack(values))  # noqa: E741 (as in the equations)
        for i in range(robot.n):
            of_tube = ((f"theta_{i + 1}_rad", theta, drive.matrix_theta), (f"l_{i + 1}_m", l, drive.matrix_l))
            for name, commanded, matrix in of_tube:
                movers = [str(columns[joint.name]) for joint, by in zip(drive.joints, matrix[i], strict=True) if by]
                self._numbers[name], self.names[name] = commanded[:, i], " and ".join(movers) or name

    def _add_poses(self, robot: Robot, frame: FrameEntry | str | None) -> None:
        columns, unit = self._columns, SI[self._entry.units.position]
        for key, given in (("position", columns.position), ("tangent", columns.tangent), *columns.markers.items()):
            axes = [str(column).removeprefix("-") for column in given or () if column != ""]
            if twice := next((axis for k, axis in enumerate(axes) if axis in axes[:k]), None):
                place = (key,) if key in ("position", "tangent") else ("markers", key)
                raise self._document.fault(f"has {twice} for two axes", "columns", *place)
        if columns.position is None and (columns.tangent is not None or not columns.markers):
            raise self._document.fault("is missing", "columns", "position")
        for name, column in zip(POSITION, columns.position or (), strict=columns.position is not None):
            self._cells[name] = self._cell(column, unit, "position", POSITION.index(name), poses=True)
        seen = [(t, c) for t, c in zip(TANGENT, columns.tangent or (), strict=columns.tangent is not None) if c != ""]
        for name, column in seen:
            self._cells[name] = self._cell(column, 1.0, "tangent", TANGENT.index(name), poses=True)
        points = [self._add_marker(name, given, robot, unit) for name, given in columns.markers.items()]
        if not isinstance(frame, FrameEntry):
            return
        if len(seen) not in (0, 3):
            raise self._document.fault("and tangents of two components exclude each other", *self._place, "frame")
        if any(len(names) < 3 for names in points):
            raise self._document.fault("and markers of two coordinates exclude each other", *self._place, "frame")
        turn = self._rotation(frame)
        shift = np.multiply(frame.position_mm, 1e-3)
        for names in ([POSITION] if columns.position else []) + points:
            self._move(names, turn, shift)
        if seen:
            self._move(TANGENT, turn, np.zeros(3))

    def _add_marker(self, name: str, given: Sequence[Column], robot: Robot, unit: float) -> tuple[str, ...]:
        """Names of the columns that there are of a marker."""
        known = {marker.name: marker for marker in robot.markers}
        if name not in known:
            rule = f"must name a marker of the robot: {', '.join(known) or 'its file has no [[marker]]'}"
            raise self._document.fault(rule, "columns", "markers", name)
        there = [(k, column) for k, column in enumerate(given) if column != ""]
        for k, column in there:
            self._cells[known[name].columns[k]] = self._cell(column, unit, "markers", name, k, poses=True)
        return tuple(known[name].columns[k] for k, _ in there)

    def _rotation(self, frame: FrameEntry) -> Rotation:
        from scipy.spatial.transform import Rotation  # slow to import

        w, x, y, z = frame.quaternion_wxyz
        if not abs(math.hypot(w, x, y, z) - 1) <= NORM_TOLERANCE:
            rule = f"must have norm 1 within {NORM_TOLERANCE}"
            raise self._document.fault(rule, *self._place, "frame", "quaternion_wxyz")
        return Rotation.from_quat([x, y, z, w])

    def _move(self, names: Sequence[str], turn: Rotation, shift: Array) -> None:
        """From the tracker's frame into the robot's."""
        vectors = np.column_stack([self.numbers(name, blanks=True) for name in names]) - shift
        given = np.isfinite(vectors).all(axis=1)
        vectors[given] = turn.inv().apply(vectors[given])
        self._numbers |= {name: vectors[:, k] for k, name in enumerate(names)}
        self.names |= {name: self._cells.pop(name).name for name in names}


@dataclass(frozen=True)
class Source:
    """A table and what a mapping file says of it besides its columns."""

    table: CsvTable
    is_mapped: bool = False
    tracker: str = ""  # sources with the same one share its frame
    homing: str = ""  # sources with the same one share the zeros of the joints
    is_registered: bool = True  # whether the robot's place in that frame is known
    of_collars: bool = False  # whether joints are those of the tubes' collars rather than what was commanded
    wrapped: bool | None = None  # whether rotations are kept within one turn; None: as the values look
    at_rest: bool | None = None  # whether joints stood still at the poses; None: as rows and tips look


def sources(path: str | os.PathLike[str], robot: Robot, what: str) -> list[Source]:
    """The tables of a CSV file, one, or of a mapping file (TOML), one for each run. Raises InputError."""
    name = file_name(path, "a CSV file, or of a mapping file (TOML)")
    if not name.lower().endswith(".toml"):
        return [Source(CsvTable(name, what))]
    document = read_document(name)
    entry = document.to(MappingEntry)
    wrapped = None if entry.rotations is None else entry.rotations == "wrapped"
    _require_one_frame(entry.run, document)
    tables = [MappedTable(entry, k, robot, document) for k in range(len(entry.run))]
    known: dict[str, int] = {}
    for k, table in enumerate(tables):
        if (first := known.setdefault(table.sha256, k)) != k:
            raise document.fault(f"has what run {first + 1} has: every pose would count twice", "run", k)
    return [
        Source(
            table=table,
            is_mapped=True,
            tracker=run.tracker,
            homing=run.homing,
            is_registered=run.frame != "unknown",
            of_collars=entry.values == "collars",
            wrapped=wrapped,
            at_rest=entry.at_rest,
        )
        for table, run in zip(tables, entry.run, strict=True)
    ]


def _require_one_frame(runs: Sequence[RunEntry], document: Document) -> None:
    frames: dict[str, FrameEntry | str | None] = {}
    for k, run in enumerate(runs):
        if frames.setdefault(run.tracker, run.frame) != run.frame:
            rule = (
                f"differs from that of another run of the tracker {run.tracker!r}, which has one frame: say it in each"
            )
            raise document.fault(f"{rule}, or name another tracker", "run", k, "frame")
