"""Clearance of whole bodies out of distances at points: what lies between two points is looked at too.

Between two points h apart an obstacle as thin as a wire comes nearer than at either. A point of clearance c stands for
for the body within h / 2 of it, whose clearance is at least sqrt(c^2 - h^2 / 4). Where that is not enough, the body
between the points is looked at.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

PARTS = 4  # of the body around a point


def beside(clearance_m: Array, half_m: float) -> Array:
    """Lower bound of the clearance within `half_m` of points with clearances (K,), their radius not taken off."""
    far = np.maximum(clearance_m, half_m)
    return np.where(clearance_m > half_m, np.sqrt(far**2 - half_m**2), clearance_m - half_m)


def around(points: Array, at: NDArray[np.intp], begins: NDArray[np.bool_] | None = None) -> Array:
    """(..., PARTS * K, 3) points of the pieces of polylines (..., N, 3) around their points at (K,), K by K.

    Each is PARTS times shorter than the piece, in whose middle the point itself stands. `begins` (N,) tells the first
    point of each polyline where several stand in one row.
    """
    count = points.shape[-2]
    first = np.zeros(count, dtype=bool) if begins is None else begins
    before = np.where((at == 0) | first[at], at, at - 1)
    after = np.minimum(at + 1, count - 1)
    after = np.where(first[after], at, after)
    middle = points[..., at, :]
    shares = (np.arange(PARTS // 2) + 0.5) / PARTS  # of the way to a neighbour
    sides = [middle + share * (points[..., to, :] - middle) for to in (before, after) for share in shares]
    return np.concatenate(sides, axis=-2)
