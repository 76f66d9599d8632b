"""What stands at the robot's base besides it: a sheath, an endoscope, a drive unit, which must not touch either."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shape import PartShape
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arguments import Flag, Made, Number, Text, require
from ctrplan.base.arrays import LONGEST_MM, MM_PER_M, Array
from ctrplan.base.package import shown

MARGIN = Number(0, LONGEST_MM / MM_PER_M, "m")
WITHIN_M = 0.05e-3  # of the truth, from below
MOST = 200_000  # pieces of a surface looked at together
SAMPLED = 20_000  # vertices of a part that may lie within a fixture


@shown
@dataclass(frozen=True, eq=False)
class Fixture:
    """A body in the robot's frame, fixed to its base.

    stays_inside: whether it stands in the lumens, too, and has to stay there; else only parts to avoid count.
    Raises InputError for another name, shape or margin.
    """

    name: str
    shape: PartShape
    margin_m: float = 0.0
    stays_inside: bool = False
    source_table: Mapping[str, Any] | None = None  # the table of a scenario file that it was read from, files as paths

    def __post_init__(self) -> None:
        """Checks what was given; the shape has checked itself."""
        require("name", self.name, Text())
        require("shape", self.shape, Made("PartShape"))
        require("margin_m", self.margin_m, MARGIN)
        require("stays_inside", self.stays_inside, Flag())

    def clearance(self, parts: Sequence[AnatomyPart], position_m: Array, R: Array) -> tuple[float, Array]:
        """What parts leave it beyond its margin and theirs [m], and where (3,); its base at position (3,), R (3, 3).

        At most WITHIN_M less than the truth, never more; inf where no part counts.
        """
        counted = [part for part in parts if self.stays_inside or part.role == "avoid"]
        if not counted:
            return np.inf, position_m
        pieces, radius = self._pieces()
        least, place = _least(counted, pieces @ R.T + position_m)
        least -= radius
        for part in counted:
            if part.role == "avoid" and (within := _within(self.shape, part, position_m, R)) is not None:
                least, place = min((least, place), within, key=lambda candidate: candidate[0])
        return least - self.margin_m, place

    def _pieces(self) -> tuple[Array, float]:
        """Segments or triangles (K, 2 or 3, 3) of which all points within a radius are the body's surface."""
        shape = self.shape
        if isinstance(shape, Capsule):
            return np.stack([shape.from_m, shape.to_m])[None], shape.radius_m
        if isinstance(shape, Sphere):
            return np.stack([shape.center_m, shape.center_m])[None], shape.radius_m
        surface = shape.surface()
        return surface.vertices_m[surface.faces], 0.0


def _least(parts: Sequence[AnatomyPart], pieces: Array) -> tuple[float, Array]:
    """Smallest clearance on pieces (K, m, 3), those halved that may have a smaller one: clearance is 1-Lipschitz."""
    best, place, left = np.inf, pieces[0, 0], np.inf
    while len(pieces):
        middle = pieces.mean(axis=1)
        clearance = exact_clearance(parts, middle)
        reach = np.linalg.norm(pieces - middle[:, None], axis=2).max(axis=1)
        if clearance.min() < best:
            best, place = float(clearance.min()), middle[np.argmin(clearance)]
        below = clearance - reach
        open_ = (below < best - WITHIN_M) & (len(pieces) <= MOST)
        left = min(left, float(below[~open_].min(initial=np.inf)))
        pieces = _halved(pieces[open_])
    return min(best, left), place


def _halved(pieces: Array) -> Array:
    """Each piece (K, m, 3) as two, cut through the middle of its longest side."""
    count = pieces.shape[1]
    sides = np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2)
    rows, start = np.arange(len(pieces)), sides.argmax(axis=1)
    end = (start + 1) % count
    middle = (pieces[rows, start] + pieces[rows, end]) / 2
    first, second = pieces.copy(), pieces.copy()
    first[rows, start], second[rows, end] = middle, middle
    return np.concatenate([first, second])


def _within(shape: PartShape, part: AnatomyPart, position_m: Array, R: Array) -> tuple[float, Array] | None:
    """The deepest vertex of a part within a body, if any is: a part that the body swallows touches no surface of it."""
    vertices = part.shape.surface().vertices_m
    vertices = vertices[:: len(vertices) // SAMPLED + 1]
    distance = shape.distance((vertices - position_m) @ R)
    deepest = int(np.argmin(distance))
    return (float(distance[deepest]) - part.margin_m, vertices[deepest]) if distance[deepest] < 0 else None
