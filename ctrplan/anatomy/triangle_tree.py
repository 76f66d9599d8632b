"""Exact distances to the triangles of a surface, by the core's tree of boxes.

A certificate asks for hundreds of thousands of them. The tree looks for the triangle nearest to a point, beginning with
that of the point before it, which is near along a body. Other threads work meanwhile.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan import _model
from ctrplan.base.arrays import Array


class TriangleTree:
    """Of one surface; can't be pickled."""

    def __init__(self, vertices_m: Array, faces: NDArray[np.int64]) -> None:
        """vertices_m (V, 3) [m], faces (F, 3) indices of them.

        Raises ValueError without faces or where they name vertices that are not there.
        """
        self.core = _model.TriangleTree(np.ascontiguousarray(vertices_m), np.ascontiguousarray(faces))

    def distance(self, points_m: Array) -> Array:
        """(K,) [m] from points (K, 3) [m] to the nearest triangle, zero or more."""
        return np.asarray(self.core.distance(np.ascontiguousarray(points_m)))
