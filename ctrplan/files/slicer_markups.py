"""Points and lines that were placed in 3D Slicer, and the frame that its files are in.

Slicer shows RAS and takes files for LPS unless they say otherwise; what is written here is in LPS and says so.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.anatomy.patient_frame import FRAMES, Frame, signs
from ctrplan.base.arguments import in_plain_digits
from ctrplan.base.arrays import LONGEST_MM, MM_PER_M, UNITS_M, Array
from ctrplan.errors import InputError
from ctrplan.storage.csv_table import file_bytes

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

SPACE: Frame = "LPS"  # of all files


SCENE = "scene.mrml"  # of a case folder: what 3D Slicer is to open


def patient_frame(scenario: Scenario, given: str | None) -> Frame:
    """The frame of a scenario's anatomy: the one that its file says, or else the one given.

    Raises InputError where nobody says one, since a guess could turn the patient around, and where two are said.
    """
    own = scenario.frame
    if own is not None and given is not None and own != given:
        raise InputError(f"contradicts the scenario, which says {own}", key="--frame", value=given)
    for frame in FRAMES:
        if (own or given) == frame:
            return frame
    rule = "must be RAS or LPS: which axes the anatomy's frame has in the patient can't be guessed"
    raise InputError(rule, key="--frame", value=... if given is None else given)


def to_lps(frame: Frame) -> Array:
    """(3, 3) maps vectors of the anatomy's frame to LPS."""
    return np.diag(signs(frame, SPACE))


def lps_mm(points_m: Array, frame: Frame) -> Array:
    """Points (..., 3) [m] of the anatomy's frame in LPS [mm]."""
    turned: Array = points_m * signs(frame, SPACE) * MM_PER_M
    return turned + 0.0  # no minus zero


SUFFIXES = (".mrk.json", ".fcsv")
LARGEST_FILE_BYTES = 20_000_000
LINES, POINTS = ("Line", "Curve"), ("Fiducial",)
PLACED = "defined"  # positionStatus of a point that has a place
FCSV_STATUS = {"0": "undefined", "1": "preview", "3": "missing"}  # behind the columns that are named; 2 is placed
UNITS = ("mm", "cm", "m", "um")
FCSV_FRAMES: dict[str, Frame] = {"0": "RAS", "1": "LPS", "RAS": "RAS", "LPS": "LPS"}  # 4.10 and before wrote numbers
FCSV_COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"


@dataclass(frozen=True, eq=False)
class PlacedMarkup:
    """Points of a file in mm, in the frame that the file says; None where it says none. A line is gone along."""

    file: str
    points_mm: Array  # (K, 3)
    labels: tuple[str, ...]  # of the points; empty texts where they have none
    frame: Frame | None
    is_line: bool
    notes: tuple[str, ...] = ()  # of points that were left out, or are hidden

    @property
    def name(self) -> str:
        """The name of the file, without what says that it is one of markups."""
        name = Path(self.file).name
        return next((name[: -len(suffix)] for suffix in SUFFIXES if name.lower().endswith(suffix)), "")


def is_markups(path: str | os.PathLike[str]) -> bool:
    """Whether the name is that of a file of markups."""
    return os.fspath(path).lower().endswith(SUFFIXES)


def read_markups(path: str | os.PathLike[str]) -> list[PlacedMarkup]:
    """What a file holds. Raises InputError for points that are none, and for markups that are neither points nor lines.

    The frame is what the file says; nothing is assumed where it says none.
    """
    file = os.fspath(path)
    text = _text(file)
    return [_from_fcsv(file, text)] if file.lower().endswith(".fcsv") else _from_json(file, text)


def _text(file: str) -> str:
    try:
        return file_bytes(file, LARGEST_FILE_BYTES, "markups", "file of markups").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 text (byte {error.start})", file=file) from None


def _from_json(file: str, text: str) -> list[PlacedMarkup]:
    try:
        markups = json.loads(text, object_pairs_hook=lambda pairs: _object(file, pairs))["markups"]
        results = [_markup(file, markup, f"markups.{k}") for k, markup in enumerate(markups, start=1)]
    except (ValueError, RecursionError) as error:
        raise InputError(f"is no JSON ({error})", file=file) from None
    except (KeyError, TypeError, AttributeError):
        raise InputError('is no file of markups: a list "markups" of points or lines is needed', file=file) from None
    if not results:
        raise InputError("holds no markups", file=file)
    return results


def _object(file: str, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON. Raises InputError for a key that it has twice with unlike values."""
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result and result[key] != value:
            raise InputError(f"says {key} twice, and differently", file=file)
        result[key] = value
    return result


def _markup(file: str, markup: dict[str, Any], key: str) -> PlacedMarkup:
    kind = markup.get("type")
    if kind not in (*LINES, *POINTS):
        rule = f"must be one of {', '.join((*POINTS, *LINES))}: nothing else says targets and entries"
        raise InputError(rule, file=file, key=f"{key}.type", value=kind)
    rows, labels, notes = list[list[float]](), list[str](), list[str]()
    scale = _mm_per_unit(file, markup.get("coordinateUnits", "mm"), key)
    for k, point in enumerate(markup.get("controlPoints", []), 1):
        label, status = str(point.get("label", "")), point.get("positionStatus", PLACED)
        if status != PLACED:
            notes.append(_left_out(file, k, label, f"positionStatus is {status}"))
            continue
        rows.append(_position(file, point.get("position"), f"{key}.controlPoints.{k}", scale))
        labels.append(label)
        if not (point.get("visibility", True) and point.get("selected", True)):
            notes.append(_hidden(file, k, label))
    if not rows:
        rule = f"has no points{' that were placed' if notes else ''}"
        raise InputError(rule, file=file, key=key)
    if kind in LINES and len(rows) < 2:
        raise InputError(f"is a {kind} of one point that was placed: it needs two", file=file, key=key)
    frame = _frame(file, markup, key)
    return PlacedMarkup(file, np.array(rows), tuple(labels), frame, kind in LINES, tuple(notes))


def _left_out(file: str, number: int, label: str, why: str) -> str:
    return f"{_point(file, number, label)} is left out, it has no place ({why})"


def _hidden(file: str, number: int, label: str) -> str:
    return f"{_point(file, number, label)} is hidden or not selected in 3D Slicer, and is taken all the same"


def _point(file: str, number: int, label: str) -> str:
    return f"{Path(file).name}: point {number}{f' ({label})' if label else ''}"


def _frame(file: str, markup: dict[str, Any], key: str) -> Frame | None:
    stated = markup.get("coordinateSystem")
    if stated is None:
        return None
    for frame in FRAMES:
        if stated == frame:
            return frame
    is_number = str(stated) in FCSV_FRAMES
    hint = " (of numbers 0 is RAS and 1 is LPS in .fcsv, here none is known)" if is_number else ""
    raise InputError(f"must be RAS or LPS{hint}", file=file, key=f"{key}.coordinateSystem", value=stated)


def _mm_per_unit(file: str, stated: Any, key: str) -> float:
    unit = stated[0] if isinstance(stated, list) and stated else stated  # with its coding scheme beside it
    if not isinstance(unit, str) or unit not in UNITS:
        rule = f"must be one of {', '.join(UNITS)}"
        raise InputError(rule, file=file, key=f"{key}.coordinateUnits", value=stated)
    return MM_PER_M * UNITS_M[unit]


def _position(file: str, position: Any, key: str, scale: float) -> list[float]:
    is_list = isinstance(position, list) and len(position) == 3
    if not is_list or not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in position):
        raise InputError("must have three numbers", file=file, key=f"{key}.position", value=position)
    return _near(file, [float(x) * scale for x in position], f"{key}.position")


def _near(file: str, position: list[float], key: str) -> list[float]:
    if not all(math.isfinite(x) and abs(x) <= LONGEST_MM for x in position):
        raise InputError(f"must lie from {-LONGEST_MM:g} to {LONGEST_MM:g} mm", file=file, key=key, value=position)
    return position


def _from_fcsv(file: str, text: str) -> PlacedMarkup:
    frame: Frame | None = None
    columns, rows = FCSV_COLUMNS.split(","), list[list[str]]()
    for line in text.splitlines():
        name, _, value = (part.strip() for part in line.lstrip("# ").partition("="))
        if not line.startswith("#"):
            rows += [cells for cells in csv.reader([line]) if any(cell.strip() for cell in cells)]
        elif name == "CoordinateSystem":
            if value not in FCSV_FRAMES:
                raise InputError("must be RAS or LPS", file=file, key=name, value=value)
            if frame not in (None, FCSV_FRAMES[value]):
                raise InputError(f"says another frame than the line before, {frame}", file=file, key=name, value=value)
            frame = FCSV_FRAMES[value]
        elif name == "columns":
            columns = [column.strip() for column in value.split(",")]
    if not rows or not {"x", "y", "z"} <= set(columns):
        raise InputError("holds no points" if not rows else "has no columns x, y and z", file=file)
    points, labels, notes = list[list[float]](), list[str](), list[str]()
    for k, cells in enumerate(rows, start=1):
        label = _cell(columns, cells, "label")
        status = FCSV_STATUS.get(cells[len(columns)].strip()) if len(cells) > len(columns) else None
        if status is not None:
            notes.append(_left_out(file, k, label, f"its status is {status}"))
            continue
        points.append(_row(file, columns, cells, k))
        labels.append(label)
        if "0" in (_cell(columns, cells, "vis"), _cell(columns, cells, "sel")):
            notes.append(_hidden(file, k, label))
    if not points:
        raise InputError("holds no points that were placed", file=file)
    return PlacedMarkup(file, np.array(points), tuple(labels), frame, is_line=False, notes=tuple(notes))


def _row(file: str, columns: Sequence[str], cells: Sequence[str], number: int) -> list[float]:
    texts = [_cell(columns, cells, axis) for axis in "xyz"]
    results = [in_plain_digits(text) for text in texts]
    if None in results:
        rule = "must have three numbers (commas between them, points in them)"
        raise InputError(rule, file=file, key=f"point {number}", value=", ".join(texts))
    return _near(file, [float(x) for x in results if x is not None], f"point {number}")


def _cell(columns: Sequence[str], cells: Sequence[str], name: str) -> str:
    place = columns.index(name) if name in columns else len(cells)
    return cells[place].strip() if place < len(cells) else ""
