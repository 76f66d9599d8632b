"""Exact distances to the triangles of a surface, by the core's tree of boxes.

A certificate asks for hundreds of thousands of them. The tree looks for the triangle nearest to a point, beginning with
that of the point before it, which is near along a body. Other threads work meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import ctrplan._model as _model
from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """Of one surface; can't be pickled."""

    core: _model.TriangleTree

    def distance(self, points_m: Array) -> Array:
        """(K,) [m] from points (K, 3) to the nearest triangle, zero or more."""
        return np.asarray(self.core.distance(np.ascontiguousarray(points_m)))


def triangle_tree(vertices_m: Array, faces: NDArray[np.int64]) -> TriangleTree:
    """Of vertices (V, 3) and faces (F, 3); ValueError without faces or where they name vertices that are not there."""
    return TriangleTree(_model.TriangleTree(np.ascontiguousarray(vertices_m), np.ascontiguousarray(faces)))
