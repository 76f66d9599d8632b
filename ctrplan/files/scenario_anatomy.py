"""[[anatomy]] and [[fixture]] of a scenario file: parts, what to know of them, and targets that lie in no image."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import LONGEST_MM, MM_PER_M
from ctrplan.scenario.scenario import Goal
from ctrplan.storage.toml_document import Document, TomlTable, chosen

if TYPE_CHECKING:
    from ctrplan.anatomy.fixture import Fixture
    from ctrplan.anatomy.parts import AnatomyPart
    from ctrplan.anatomy.shape import PartEntry, PartShape
    from ctrplan.base.arrays import Array


FILES, MOTION = "files", "motion_margin_mm"
MOST_PHASES = 50


def anatomy_part(table: TomlTable) -> AnatomyPart:
    """One [[anatomy]], its margin with what the surface may be off by.

    Raises InputError for a kind that there is not, and keys that it lacks or does not have.
    """
    from ctrplan.anatomy.parts import AnatomyPart

    shape, entry = _shape(table) if FILES not in table.content else _phases(table)
    return AnatomyPart(shape, entry.role, entry.margin_mm / MM_PER_M + shape.surface_error_m, _said(table))


def _said(table: TomlTable) -> dict[str, Any]:
    """The table, files named from the working folder and not from the document's."""
    folder, content = Path(table.document.file or ".").parent, copy.deepcopy(dict(table.content))
    if "file" in content:
        content["file"] = str(folder / content["file"])
    if FILES in content:
        content[FILES] = [str(folder / file) for file in content[FILES]]
    return content


def _shape(table: TomlTable) -> tuple[PartShape, PartEntry]:
    from ctrplan.anatomy.shape import CATALOGUE, PartEntry

    if MOTION in table.content:
        raise table.fault(f"goes with {FILES}, the structure in several phases", MOTION)
    entry = chosen(table, "kind", CATALOGUE, PartEntry)
    return entry.shape(table), entry


def _phases(table: TomlTable) -> tuple[PartShape, PartEntry]:
    """A structure of which `files` has the phases: each is read as if it were the one `file`."""
    from ctrplan.anatomy.parts import Phases

    content = dict(table.content)
    files, margin = content.pop(FILES), content.pop(MOTION, None)
    if not isinstance(files, list) or not 2 <= len(files) <= MOST_PHASES:
        raise table.fault(f"must be a list of 2 to {MOST_PHASES} files, one of each phase", FILES)
    if "file" in content:
        raise table.fault(f"and {FILES} exclude each other", "file")
    if margin is None:
        raise table.fault(f"is missing: {FILES} need what is kept for places between the phases", MOTION)
    if isinstance(margin, bool) or not isinstance(margin, (int, float)) or not 0 <= margin <= LONGEST_MM:
        raise table.fault(f"must be a number from 0 to {LONGEST_MM:g}", MOTION)
    read = [_shape(table.replaced({**content, "file": file})) for file in files]
    entry = read[0][1]
    return Phases(tuple(shape for shape, _ in read), entry.role, margin / MM_PER_M), entry


def fixture(table: TomlTable) -> Fixture:
    """One [[fixture]], in the robot's frame. Raises InputError."""
    from ctrplan.anatomy.fixture import Fixture

    content = dict(table.content)
    name, stays = content.pop("name", None), content.pop("stays_inside", False)
    if name is not None and not (isinstance(name, str) and name.isprintable() and 0 < len(name) <= 80):
        raise table.fault("must be a text of 1 to 80 characters", "name")
    if not isinstance(stays, bool):
        raise table.fault("must be true or false", "stays_inside")
    if "role" in content:
        raise table.fault("goes with [[anatomy]]: a fixture keeps clear of what is to be avoided", "role")
    shape, entry = _shape(table.replaced(content, without=("frame",)))  # it stands in the robot's frame, no patient's
    margin = entry.margin_mm / MM_PER_M + shape.surface_error_m
    return Fixture(name or shape.name, shape, margin, stays, _said(table))


def anatomy_notes(parts: Sequence[AnatomyPart]) -> tuple[str, ...]:
    """What was repaired or left open in reading the parts, a sentence each."""
    return tuple(
        f"anatomy.{k} ({part.shape.name}) {note}." for k, part in enumerate(parts, 1) for note in part.shape.notes
    )


def refuse_targets_outside_images(parts: Sequence[AnatomyPart], goals: Sequence[Goal], document: Document) -> None:
    """Raises InputError for a tip position that lies in none of the images, with how far, and whether a flip helps."""
    shapes = [shape for part in parts for shape in getattr(part.shape, "shapes", (part.shape,))]
    boxes = [box for shape in shapes if (box := getattr(shape, "image_box_m", None)) is not None]
    if not boxes:
        return
    for goal in goals:
        if goal.tip_m is None or min(_outside_m(box, goal.tip_m) for box in boxes) <= 0:
            continue
        apart_mm = min(_outside_m(box, goal.tip_m) for box in boxes) * MM_PER_M
        turned = goal.tip_m * (-1, -1, 1)
        flipped = any(_outside_m(box, turned) <= 0 for box in boxes)
        hint = ": with x and y turned round it is within one, is it in the scenario's frame?" if flipped else ""
        steps = [
            int(step) - 1 if step.isdigit() else step for step in (*goal.table.split("."), *goal.tip_key.split("."))
        ]
        raise document.fault(f"lies {apart_mm:.3g} mm outside all images{hint}", *steps)


def _outside_m(corners_m: Array, point_m: Array) -> float:
    """How far a point (3,) is outside a box with corners (8, 3), ordered as binary numbers; 0 within."""
    edges = corners_m[[4, 2, 1]] - corners_m[0]
    lengths = np.linalg.norm(edges, axis=1)
    along = (edges / lengths[:, None]) @ (point_m - corners_m[0])
    return float(np.linalg.norm(along - np.clip(along, 0, lengths)))
