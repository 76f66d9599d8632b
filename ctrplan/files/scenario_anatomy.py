"""[[anatomy]] of a scenario file -> parts, what there is to know of them, and targets that lie in no image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.units import MM_PER_M
from ctrplan.files.chosen_table import chosen
from ctrplan.planning.scenario import Goal
from ctrplan.storage.toml_document import Document
from ctrplan.storage.toml_table import Table

if TYPE_CHECKING:
    from ctrplan.anatomy.parts import AnatomyPart
    from ctrplan.base.arrays import Array


def anatomy_part(table: Table) -> AnatomyPart:
    """One [[anatomy]], its margin with what the surface may be off by.

    Raises InputError for a kind that there is not, and keys that it lacks or does not have.
    """
    from ctrplan.anatomy.parts import AnatomyPart
    from ctrplan.anatomy.shape import PartEntry
    from ctrplan.anatomy.shape_catalogue import CATALOGUE

    entry = chosen(table, "kind", CATALOGUE, PartEntry)
    shape = entry.shape(table)
    return AnatomyPart(shape, entry.role, entry.margin_mm / MM_PER_M + shape.surface_error_m)


def anatomy_notes(parts: Sequence[AnatomyPart]) -> tuple[str, ...]:
    """What was repaired or left open in reading the parts, a sentence each."""
    return tuple(
        f"anatomy.{k} ({part.shape.name}) {note}." for k, part in enumerate(parts, 1) for note in part.shape.notes
    )


def refuse_targets_outside_images(parts: Sequence[AnatomyPart], goals: Sequence[Goal], document: Document) -> None:
    """Raises InputError for a tip position that lies in none of the images, with how far, and whether a flip helps."""
    boxes = [box for part in parts if (box := getattr(part.shape, "image_box_m", None)) is not None]
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
