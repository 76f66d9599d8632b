"""Structures of the anatomy, also such as move (several phases of breath or heart beat, all of them to be kept clear
of), the exact clearance that they leave to a point, and which of many matter around a place.

The clearance of a point is the minimum over the parts to avoid of (distance outside the part - its margin). Several
lumens are one room: the robot stays within their union, so of the parts with role "inside" the largest of (distance
inside the part - its margin) counts, and the minimum is then taken with the parts to avoid. Near the seam of two
overlapping lumens this is less than the distance to the wall of their union, never more. Every distance is to a surface
and therefore 1-Lipschitz, and so is the clearance.

A certificate asks for hundreds of thousands of them. The tree looks for the triangle nearest to a point, beginning with
that of the point before it, which is near along a body. Other threads work meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.anatomy.shape import PartShape, Role
from ctrplan.base.arguments import Made, require
from ctrplan.base.arrays import MM_PER_M, ROUNDING_M, Array, content_sha256
from ctrplan.base.package import of_this_process, shown
from ctrplan.base.surface import Surface
from ctrplan.errors import CtrplanError, InputError

CHUNK_POINTS = 1 << 14  # at once: what lies between a point and its distance stays in a processor's cache


@shown
@dataclass(frozen=True, eq=False)
class AnatomyPart:
    """A shape of the anatomy and what the robot has to do with it; compared and hashed by identity.

    role: "avoid" (the robot stays outside) or "inside" (the robot stays within the union of all such parts).
    margin_m: distance to keep from the surface on the allowed side [m]. Raises InputError for another role or margin.
    """

    shape: PartShape
    role: Role = "avoid"
    margin_m: float = 0.0
    source_table: Mapping[str, Any] | None = None  # the table of a scenario file that it was read from, files as paths

    def __post_init__(self) -> None:
        """Checks role and margin; the shape has checked itself."""
        require("shape", self.shape, Made("PartShape"))
        if self.role not in ("avoid", "inside"):
            raise InputError("must be 'avoid' or 'inside'", key="role", value=self.role)
        if not (np.isfinite(self.margin_m) and self.margin_m >= 0):
            raise InputError("must be a finite number, zero or more", key="margin_m", value=self.margin_m, unit="m")

    @cached_property
    def sha256(self) -> str:
        """Hash of its content: kind and numbers of the shape, role and margin; where they came from does not count."""
        numbers = [np.asarray(each) for each in self.shape.content()]
        return content_sha256((self.shape.kind, numbers, self.shape.surface_error_m, self.role, self.margin_m))

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Lower and upper corner (3,), (3,) [m] of what the shape lies within. Raises CtrplanError for what is none."""
        box = self.shape.box()
        if np.shape(box) != (2, 3) or not np.all(np.isfinite(box)) or np.any(box[0] > box[1]):
            raise CtrplanError(
                f"Anatomy of kind {self.shape.kind!r} must say the lower and the upper corner of its box."
            )
        return box


def lumens_box(parts: Sequence[AnatomyPart]) -> tuple[Array, Array] | None:
    """Lower and upper corner (3,), (3,) [m] of what all lumens lie within; None without any."""
    boxes = [part.box for part in parts if part.role == "inside"]
    return (np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)) if boxes else None


def surface_distance(part: AnatomyPart, points_m: Array) -> Array:
    """Distance of points (K, 3) [m] to the part's surface, (K,) [m], negative within the part.

    Raises CtrplanError where the part's kind says something that is no distance.
    """
    distance = np.empty(len(points_m))
    for k in range(0, len(points_m), CHUNK_POINTS):
        points = points_m[k : k + CHUNK_POINTS]
        chunk = part.shape.distance(points)
        if np.shape(chunk) != (len(points),) or np.isnan(chunk).any():
            raise CtrplanError(f"Anatomy of kind {part.shape.kind!r} must say a distance for every point.")
        distance[k : k + CHUNK_POINTS] = chunk
    return distance


def combined_clearance(
    parts: Sequence[AnatomyPart], distance: Callable[[AnatomyPart], NDArray[np.floating]]
) -> NDArray[np.floating]:
    """Clearance from each part's `distance` (negative within the part), all arrays of one shape [m]; see the module."""
    avoid: NDArray[np.floating] | None = None
    inside: NDArray[np.floating] | None = None
    for part in parts:
        value = distance(part)
        if part.role == "inside":
            np.negative(value, out=value)
            value -= part.margin_m
            inside = value if inside is None else np.maximum(inside, value, out=inside)
        else:
            value -= part.margin_m
            avoid = value if avoid is None else np.minimum(avoid, value, out=avoid)
    if avoid is None or inside is None:
        result = inside if avoid is None else avoid
        if result is None:
            raise ValueError("combined_clearance needs at least one part")
        return result
    np.minimum(avoid, inside, out=avoid)
    return avoid


def exact_clearance(parts: Sequence[AnatomyPart], points_m: ArrayLike) -> Array:
    """Clearance (K,) [m] that the parts leave to points (K, 3) [m], without a grid; inf where there are no parts.

    Raises InputError when a coordinate is not finite.
    """
    points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise InputError("must be finite to have a clearance", key="points_m", unit="m")
    if not parts:
        return np.full(len(points), np.inf)
    return np.asarray(combined_clearance(parts, lambda part: surface_distance(part, points)), dtype=np.float64)


class TriangleTree:
    """A tree of boxes over the triangles of one surface. Thread-safe; the GIL is released."""

    __reduce__ = of_this_process("make another of the surface")

    def __init__(self, vertices_m: Array, faces: NDArray[np.int64]) -> None:
        """vertices_m (V, 3) [m], faces (F, 3) indices of them.

        Raises ValueError without faces or where they name vertices that are not there.
        """
        self.core = _model.TriangleTree(np.ascontiguousarray(vertices_m), np.ascontiguousarray(faces))

    def distance(self, points_m: Array) -> Array:
        """(K,) [m] from points (K, 3) [m] to the nearest triangle, zero or more."""
        return np.asarray(self.core.distance(np.ascontiguousarray(points_m)))


FEW = 8  # parts that are asked straight away
MANY = 64  # parts of which boxes are looked at first, where places are few: boxes of many take longer than they save
CELL_M = 10e-3  # within which points are asked together


def nearby(parts: Sequence[AnatomyPart], places_m: Array, radius_m: float) -> list[tuple[AnatomyPart, ...]]:
    """For each of C places (C, 3) [m] the parts that may decide the clearance of any point within `radius_m` of it.

    Distances change by no more than a point moves, so that a part stays behind the nearest one wherever it is behind
    by twice the radius. Lumens are one room: of them those count that a point may be deepest in.
    """
    matters = np.ones((len(parts), len(places_m)), dtype=bool)
    for role, sign in (("avoid", 1.0), ("inside", -1.0)):
        rows = [k for k, part in enumerate(parts) if part.role == role]
        if not rows:
            continue
        if sign > 0 and len(rows) > MANY and len(places_m) <= FEW:
            matters[rows] = False
            rows = [rows[k] for k in np.flatnonzero(_within_reach([parts[k] for k in rows], places_m, radius_m))]
        margin = np.array([[parts[k].margin_m] for k in rows])
        clearance = sign * np.array([surface_distance(parts[k], places_m) for k in rows]) - margin
        behind = clearance - clearance.min(axis=0) if sign > 0 else clearance.max(axis=0) - clearance
        matters[rows] = behind <= 2 * radius_m
    return [tuple(parts[k] for k in np.flatnonzero(column).tolist()) for column in matters.T]


def _within_reach(parts: Sequence[AnatomyPart], places_m: Array, radius_m: float) -> NDArray[np.bool_]:
    """(K,) which parts to avoid may matter around any of the places (C, 3) [m], by boxes alone: none is asked.

    A surface is nowhere nearer than its box, seen from outside, and nowhere farther than the box's farthest corner.
    """
    lower, upper = (np.array([part.box[end] for part in parts])[:, None] for end in (0, 1))
    margin = np.array([part.margin_m for part in parts])
    outside = np.maximum(np.maximum(lower - places_m, places_m - upper), 0.0)
    nearest = np.linalg.norm(outside, axis=2)
    nearest[nearest == 0] = -np.inf  # within the box, maybe deep in the part
    farthest = np.linalg.norm(np.maximum(np.abs(places_m - lower), np.abs(places_m - upper)), axis=2)
    least = (farthest - margin[:, None]).min(axis=0)
    reach: NDArray[np.bool_] = (nearest - margin[:, None] <= least + 2 * radius_m + ROUNDING_M).any(axis=1)
    return reach


def exact_clearance_of_many(parts: Sequence[AnatomyPart], points_m: Array) -> Array:
    """The exact clearance of many parts and points, cell by cell: the digits of `exact_clearance` in a fraction of
    its time.
    """
    points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
    if len(parts) <= FEW or not len(points) or not np.isfinite(points).all():
        return exact_clearance(parts, points)
    clearance = np.empty(len(points))
    for rows, few in _cells(parts, points):
        clearance[rows] = exact_clearance(few, points[rows])
    return clearance


def _cells(parts: Sequence[AnatomyPart], points: Array) -> Iterator[tuple[NDArray[np.intp], tuple[AnatomyPart, ...]]]:
    """Rows of the points in each cell, and the parts that may matter there."""
    cells, owner = np.unique(np.floor(points / CELL_M), axis=0, return_inverse=True)
    order = np.argsort(owner.ravel(), kind="stable")
    rows = np.split(order, np.cumsum(np.bincount(owner.ravel()))[:-1])
    radius = CELL_M * np.sqrt(3) / 2 * (1 + 1e-9)
    yield from zip(rows, nearby(parts, (cells + 0.5) * CELL_M, float(radius)), strict=True)


CELLS = 4  # along a phase's longest side where ways to the next are looked at first, then along each: a budget alone


@dataclass(frozen=True, eq=False)
class Phases(PartShape):
    """shapes: the structure in each phase, in their order. Avoided is their union, stayed inside of what they share.

    Raises InputError for fewer than two.
    """

    kind = "phases"
    shapes: tuple[PartShape, ...]
    role: Role
    motion_margin_m: float  # kept besides the margin, for places between the phases

    def __post_init__(self) -> None:
        """Checks that there are several."""
        if len(self.shapes) < 2:
            raise InputError("must hold two phases at least", key="files")

    def distance(self, points_m: Array) -> Array:
        """To the union, or to what all share."""
        every = [shape.distance(points_m) for shape in self.shapes]
        return np.asarray(np.min(every, axis=0) if self.role == "avoid" else np.max(every, axis=0))

    def box(self) -> tuple[Array, Array]:
        """Around all phases."""
        boxes = [shape.box() for shape in self.shapes]
        return np.min([lower for lower, _ in boxes], axis=0), np.max([upper for _, upper in boxes], axis=0)

    def surface(self) -> Surface:
        """The surfaces of all phases together."""
        surfaces = [shape.surface() for shape in self.shapes]
        before = np.cumsum([0] + [len(s.vertices_m) for s in surfaces[:-1]])
        faces = [s.faces + count for s, count in zip(surfaces, before, strict=True)]
        return Surface(np.concatenate([s.vertices_m for s in surfaces]), np.concatenate(faces))

    @property
    def name(self) -> str:
        """Names of the phases' anatomies."""
        return ", ".join(shape.name for shape in self.shapes)

    def content(self) -> Sequence[ArrayLike]:
        """The content of all phases."""
        return [numbers for shape in self.shapes for numbers in shape.content()]

    @property
    def surface_error_m(self) -> float:  # type: ignore[override]
        """The largest of the phases', and the margin of motion."""
        return self.motion_margin_m + max(shape.surface_error_m for shape in self.shapes)

    @property
    def notes(self) -> tuple[str, ...]:  # type: ignore[override]
        """Notes of the phases, and whether the margin is what a straight way between phases would need."""
        own = tuple(f"{shape.name} {note}" for shape in self.shapes for note in shape.notes)
        half_mm, back_mm = self.apart_m() / 2 * MM_PER_M, self.ways_m[-1] / 2 * MM_PER_M
        given_mm, less = self.motion_margin_m * MM_PER_M, []
        if half_mm > given_mm:
            way = f"moves up to {2 * half_mm:.3g} mm from phase to phase, halfway {half_mm:.3g} mm away from both"
            less.append(f"{way}: more than motion_margin_mm = {given_mm:g}")
        if back_mm > max(half_mm, given_mm):
            way = f"lies {2 * back_mm:.3g} mm away from its first phase in its last"
            less.append(f"{way}: where it goes on from there, as in a beat, name the first again as the last")
        return (*own, *less)

    def apart_m(self) -> float:
        """How far the surface of one phase lies from that of the next, at the most."""
        return max(self.ways_m[:-1])

    @cached_property
    def ways_m(self) -> tuple[float, ...]:
        """How far the surface of each phase lies from that of the next, at the most; of the last from the first."""
        return tuple(_between_m(*both) for both in zip(self.shapes, (*self.shapes[1:], self.shapes[0]), strict=True))


def _between_m(one: PartShape, other: PartShape) -> float:
    """The farthest that a vertex of either surface lies from the other surface [m]."""
    return max(_farthest_m(a.surface().vertices_m, b) for a, b in ((one, other), (other, one)))


def _farthest_m(vertices_m: Array, shape: PartShape) -> float:
    """The largest distance of vertices (V, 3) to a surface [m]: distances change by no more than a point moves, so that
    one vertex of each cell tells which cells may hold a larger one, and finer cells of those are looked at next.
    """
    largest, size_m = 0.0, max(float(np.ptp(vertices_m, axis=0).max()) / CELLS, ROUNDING_M)
    while len(vertices_m):
        _, first, owner = np.unique(np.floor(vertices_m / size_m), axis=0, return_index=True, return_inverse=True)
        away = np.abs(shape.distance(vertices_m[first]))
        largest, owner = max(largest, float(away.max())), owner.ravel()
        left = away[owner] + np.linalg.norm(vertices_m - vertices_m[first[owner]], axis=1) > largest
        left[first] = False
        vertices_m, size_m = vertices_m[left], size_m / CELLS
    return largest
