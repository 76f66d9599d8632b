"""Structures as targets: a nodule that a scan shows is gone to in its middle, and is nothing to be avoided."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.anatomy.shape import Shape
from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.cases.inputs import Found
from ctrplan.cases.points import WORDS, is_point, says
from ctrplan.cases.request import Place
from ctrplan.cases.roles import matching
from ctrplan.cases.structures import Structure
from ctrplan.files.slicer.markups_file import Markup

ACROSS = 24  # places along each side of a body's box at which its depth is looked at
TARGET = "--target"


def aimed_at(found: Found, places: Sequence[Place] | None, roles: Sequence[str]) -> dict[str, Structure]:
    """Structures that are targets, by what they are called: as said, or by their names where nothing is said.

    roles: what the options say of structures; one that has a role by them is no target by its name.
    """
    if places is not None:
        names = [place for place in places if isinstance(place, str) and not is_point(place, found.markups)]
        return {name: one for name in names if (one := matching(found, TARGET, name)) is not None}
    if any(says(markup, WORDS[TARGET]) for markup in found.markups):
        return {}
    said = [matching(found, TARGET, name) for name in roles]
    return {one.name: one for one in found.structures if one not in said and WORDS[TARGET].search(one.name)}


def middles(
    aimed: dict[str, Structure], frame: Frame, shape_of: Callable[[Structure], Shape]
) -> tuple[list[Markup], list[str]]:
    """The middle of each as a point in the case's frame that is called as the structure is, and a note of where."""
    points, notes = [], []
    for name, one in aimed.items():
        middle_mm = np.round(middle_m(shape_of(one)) * MM_PER_M, 3) + 0.0
        points.append(Markup(str(one.file), middle_mm[None], (name,), frame, False))
        place = ", ".join(f"{x:g}" for x in middle_mm)
        notes.append(f"{one.called} is a target: its middle [{place}] mm in {frame}")
    return points, notes


def middle_m(shape: Shape) -> Array:
    """(3,) centre of a body's volume [m]; of one that is hollow or bent away from it, the place deepest within."""
    surface = shape.surface()
    origin = surface.vertices_m.mean(axis=0)
    corners = surface.vertices_m[surface.faces] - origin
    volumes = np.einsum("fx,fx->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    centre = origin + volumes @ corners.sum(axis=1) / (4 * volumes.sum())
    if shape.distance(centre[None])[0] < 0:
        return np.asarray(centre)
    lower, upper = shape.box()
    share = (np.indices((ACROSS,) * 3).reshape(3, -1).T + 0.5) / ACROSS
    tried = lower + share * (upper - lower)
    return np.asarray(tried[int(np.argmin(shape.distance(tried)))])
