"""Distances to the anatomy as it was given: every triangle of a mesh, and formulas of its own for spheres and capsules.

The nearest triangle is libigl's. Inside or outside is the sum of the solid angles of all triangles, exact, at one point
of every run of points that can't have crossed the surface between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shape import Shape as Part
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.base.arrays import Array

Signed = Callable[[Array], Array]  # points (K, 3) in an order along a curve -> distances (K,), negative within


@dataclass(frozen=True, eq=False)
class RawAnatomy:
    """The room that an anatomy leaves; points in its frame."""

    parts: tuple[tuple[AnatomyPart, Signed], ...]

    @classmethod
    def of(cls, parts: Sequence[AnatomyPart]) -> RawAnatomy:
        """Of the parts of a scenario."""
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


def _signed(shape: Part) -> Signed:
    """The judge's own distance where it has one for the kind, else that of the kind."""
    given = vars(shape)
    if shape.kind == "sphere":
        return lambda points: np.sqrt(((points - given["center_m"]) ** 2).sum(axis=1)) - given["radius_m"]
    if shape.kind == "capsule":
        return lambda points: _from_segment(points, given["from_m"], given["to_m"]) - given["radius_m"]
    if isinstance(shape, Mesh) and shape.kind != "surface":  # which has no inside
        return _MeshDistance(given["vertices_m"], given["faces"])
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


class _MeshDistance:
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
