"""Points of the body of a solved shape, and their distances to the anatomy as it was given.

The nearest triangle is libigl's. Inside or outside is the sum of the solid angles of all triangles, exact, at one point
of every run of points that can't have crossed the surface between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shape import PartShape as Part
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.base.arrays import Array

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import Shape, TubeShape
    from ctrplan.robot.robot import Robot

SPACING_M = 0.5e-3  # between points
STRIDE = 4  # points of a body, of which one is looked at before the others
MESH_WORK = 4  # of the distances of a hundred points to a mesh, for one to a sphere


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """N points along the robot, from the plate to the tip, robot frame."""

    point_m: Array  # (N, 3)
    radius_m: Array  # (N,) outer radius of the tube there
    tube: NDArray[np.int_]  # (N,) its number, from 1

    def around(self, index: int, count: int = 10) -> BodyPoints:
        """`count` times as many points, on the chords from the point before to the one after."""
        ends = range(max(index - 1, 0), min(index + 2, len(self.tube)))
        share = np.linspace(0, len(ends) - 1, count * (len(ends) - 1) + 1)
        points = np.stack([np.interp(share, range(len(ends)), column) for column in self.point_m[ends].T], axis=1)
        radius = np.interp(share, range(len(ends)), self.radius_m[ends])
        return BodyPoints(points, radius, np.full(len(share), self.tube[index]))


def body_of(robot: Robot, shape: Shape) -> BodyPoints:
    """The body of a shape: cubic curves through the stations of each tube, along its tangents."""
    points, radii, numbers, begin = [], [], [], 0.0
    for number, (tube, solved) in enumerate(zip(robot.tubes, shape.tubes, strict=True), start=1):
        end = float(solved.s_m[-1])
        if end <= begin:
            continue
        s = np.linspace(begin, end, max(2, int(np.ceil((end - begin) / SPACING_M)) + 1))
        points.append(_curve(solved, s))
        radii.append(np.full(len(s), tube.outer_diameter_m / 2))
        numbers.append(np.full(len(s), number))
        begin = end
    return BodyPoints(np.concatenate(points), np.concatenate(radii), np.concatenate(numbers))


def _curve(tube: TubeShape, s: Array) -> Array:
    """(N, 3) at arc lengths s (N,) within the tube's: Hermite's cubics."""
    stations, points, tangents = tube.s_m, tube.centreline_m, tube.frames[:, :, 2]
    k = np.clip(np.searchsorted(stations, s, side="right") - 1, 0, len(stations) - 2)
    step = stations[k + 1] - stations[k]
    t = ((s - stations[k]) / np.where(step > 0, step, 1.0))[:, None]
    slopes = step[:, None] * tangents[k], step[:, None] * tangents[k + 1]
    curve: Array = (
        (1 + 2 * t) * (1 - t) ** 2 * points[k]
        + t * (1 - t) ** 2 * slopes[0]
        + t**2 * (3 - 2 * t) * points[k + 1]
        - t**2 * (1 - t) * slopes[1]
    )
    return curve


Signed = Callable[[Array], Array]  # points (K, 3) in an order along a curve -> distances (K,), negative within


@dataclass(frozen=True, eq=False)
class RawAnatomy:
    """The room that an anatomy leaves; points in its frame."""

    parts: tuple[tuple[AnatomyPart, Signed], ...]

    @classmethod
    def of(cls, parts: Sequence[AnatomyPart]) -> RawAnatomy:
        """The raw anatomy of the parts of a scenario."""
        return cls(tuple((part, _signed(part.shape)) for part in parts))

    def room(self, points_m: Array) -> Array:
        """(K,) [m] from points (K, 3), in an order along a curve, to what is nearest, margins taken off; inf if free.

        Several lumens are one room: the widest counts.
        """
        outside = np.full(len(points_m), np.inf)
        lumens = [-signed(points_m) - part.margin_m for part, signed in self.parts if part.role == "inside"]
        for part, signed in self.parts:
            if part.role != "inside":
                outside = np.minimum(outside, signed(points_m) - part.margin_m)
        return np.minimum(outside, np.max(lumens, axis=0)) if lumens else outside

    @property
    def work(self) -> int:
        """Work of the distances of a hundred points, in units of those of a hundred to a sphere."""
        return sum(MESH_WORK if isinstance(part.shape, Mesh) else 1 for part, _ in self.parts)

    def along(self, points_m: Array) -> Array:
        """(S, N) `room` of S curves (S, N, 3) that are near each other; every second one is gone through backwards."""
        points = points_m.copy()
        points[1::2] = points[1::2, ::-1]
        rooms = self.room(points.reshape(-1, 3)).reshape(points.shape[:2])
        rooms[1::2] = rooms[1::2, ::-1].copy()
        return rooms

    def least(self, points_m: Array, radius_m: Array) -> tuple[Array, int]:
        """(S,) least clearance of bodies (S, N, 3) with radii (N,), and how many points were looked at.

        Those next to a point in whose neighbourhood no other can be nearer are left out: no distance changes by more
        than the point moves.
        """
        count = points_m.shape[1]
        first = np.unique(np.append(np.arange(0, count, STRIDE), count - 1))
        rooms = np.full(points_m.shape[:2], np.inf)
        rooms[:, first] = self.along(points_m[:, first]) - radius_m[first]
        least = rooms.min(axis=1)
        steps = np.linalg.norm(np.diff(points_m, axis=1), axis=2)
        along = np.concatenate([np.zeros((len(points_m), 1)), np.cumsum(steps, axis=1)], axis=1)
        behind = np.maximum.accumulate(np.where(np.isin(np.arange(count), first), np.arange(count), 0))
        ahead = first[np.searchsorted(first, np.arange(count))]
        thickest = float(radius_m.max())
        outer = rooms[:, first] + radius_m[first]
        rooms_at = np.full(rooms.shape, np.inf)
        rooms_at[:, first] = outer
        bound = np.maximum(
            rooms_at[:, behind] - (along - along[:, behind]), rooms_at[:, ahead] - (along[:, ahead] - along)
        )
        rows, columns = np.nonzero((bound - thickest < least[:, None]) & ~np.isin(np.arange(count), first))
        if len(rows):
            rooms[rows, columns] = self.room(points_m[rows, columns]) - radius_m[columns]
        return rooms.min(axis=1), len(points_m) * len(first) + len(rows)


def _signed(shape: Part) -> Signed:
    """The judge's own distance where it has one for the kind, else that of the kind."""
    given = vars(shape)
    if shape.kind == "sphere":
        return lambda points: np.sqrt(((points - given["center_m"]) ** 2).sum(axis=1)) - given["radius_m"]
    if shape.kind == "capsule":
        return lambda points: _from_segment(points, given["from_m"], given["to_m"]) - given["radius_m"]
    if isinstance(shape, Mesh) and shape.kind != "surface":  # which has no inside
        return _RawMeshDistance(given["vertices_m"], given["faces"])
    return shape.distance


def _from_segment(points: Array, a: Array, b: Array) -> Array:
    """(K,) from points to a segment, by the angles at its ends."""
    axis = b - a
    long = float(axis @ axis)
    to_a, to_b = (np.sqrt(((points - end) ** 2).sum(axis=1)) for end in (a, b))
    if long == 0:
        return np.asarray(to_a)
    beside = np.linalg.norm(np.cross(points - a, axis), axis=1) / np.sqrt(long)
    before, behind = (points - a) @ axis <= 0, (points - b) @ axis >= 0
    apart: Array = np.where(before, to_a, np.where(behind, to_b, beside))
    return apart


class _RawMeshDistance:
    def __init__(self, vertices_m: Array, faces: Array) -> None:
        import igl

        self.vertices_m, self.faces = np.array(vertices_m), np.array(faces)
        self.triangles = self.vertices_m[self.faces]
        self.tree = igl.AABB()
        self.tree.init(self.vertices_m, self.faces)

    def __call__(self, points_m: Array) -> Array:
        points = np.ascontiguousarray(points_m)
        apart = np.sqrt(np.asarray(self.tree.squared_distance(self.vertices_m, self.faces, points)[0]))
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        run = np.concatenate([[0], np.cumsum(apart[:-1] + apart[1:] <= steps)])  # the surface may lie in between
        first = np.flatnonzero(np.diff(run, prepend=-1))
        deepest = [k + int(np.argmax(apart[k:end])) for k, end in zip(first, [*first[1:], len(run)], strict=True)]
        inside = np.array([winding_number(self.triangles, points[k]) > 0.5 for k in deepest])
        signed: Array = np.where(inside[run], -apart, apart)
        return signed


def winding_number(triangles: Array, point: Array) -> float:
    """How often triangles (F, 3, 3) wind around a point (3,): their solid angles (Van Oosterom, Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("fi,fi->f", a, np.cross(b, c))
    dots = [np.einsum("fi,fi->f", *pair) for pair in ((a, b), (b, c), (c, a))]
    angle = 2 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return float(angle.sum() / (4 * np.pi))
