"""Points of tubes between the stations of their shapes.

Between two stations a tube is nearly a helix: the screw motion that takes one frame to the next. What is left of the
tangents at both ends is added as a cubic (Hermite). Of a section of constant curvature this is exact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import TubeShape

ROUNDING_M = 1e-9  # beyond the ends of a tube
SMALL_RAD = 1e-4  # rotations below which series take the place of quotients


def points_on_tubes(tubes: Sequence[TubeShape], s_m: Sequence[float] | Array) -> tuple[Array, Array]:
    """Of N tubes, each at an arc length (N,) [m] from the plate: centrelines (N, 3) [m] and unit tangents (N, 3).

    NaN where the tube is not.
    """
    point, tangent = np.full((2, len(tubes), 3), np.nan)
    places, brackets = list[int](), list[tuple[Array, Array, Array, Array, float, float]]()
    for k, (tube, at) in enumerate(zip(tubes, s_m, strict=True)):
        s = tube.s_m
        if not len(s) or not s[0] - ROUNDING_M <= at <= s[-1] + ROUNDING_M:
            continue
        i = min(max(int(s.searchsorted(at)) - 1, 0), len(s) - 2)
        x = min(max(float((at - s[i]) / (s[i + 1] - s[i])), 0.0), 1.0)
        if x in (0.0, 1.0):
            point[k], tangent[k] = tube.centreline_m[i + int(x)], tube.frames[i + int(x), :, 2]
        else:
            ends = tube.centreline_m[i], tube.frames[i], tube.centreline_m[i + 1], tube.frames[i + 1]
            brackets.append((*ends, float(s[i + 1] - s[i]), x))
            places.append(k)
    if places:
        columns = (np.array(column) for column in zip(*brackets, strict=True))
        point[places], tangent[places] = _between(*columns)
    return point, tangent


def _between(p: Array, R: Array, p_next: Array, R_next: Array, h: Array, x: Array) -> tuple[Array, Array]:
    """Points (N, 3) and unit tangents (N, 3) at shares x (N,) of elements of length h (N,) between two stations."""
    back = R.transpose(0, 2, 1)
    w, share = Rotation.from_matrix(back @ R_next).as_rotvec(), x[:, None]
    v = np.linalg.solve(_swept(w), np.einsum("nij,nj->ni", back, p_next - p)[:, :, None])[:, :, 0]
    left = (
        h[:, None] * np.array([0.0, 0.0, 1.0]) - v
    )  # of the tangent at one end, and turned with the frame at the other
    right = Rotation.from_rotvec(w).apply(left)
    way = share * np.einsum("nij,nj->ni", _swept(share * w), v) + share * (1 - share) * (
        (1 - share) * left - share * right
    )
    along = Rotation.from_rotvec(share * w).apply(v)
    along = along + (1 - share) * (1 - 3 * share) * left - share * (2 - 3 * share) * right
    along = np.einsum("nij,nj->ni", R, along)
    return p + np.einsum("nij,nj->ni", R, way), along / np.linalg.norm(along, axis=1, keepdims=True)


def _swept(w: Array) -> Array:
    """(N, 3, 3) integrals of the rotations by x w, x from 0 to 1."""
    angle = np.linalg.norm(w, axis=1)
    large = np.maximum(angle, SMALL_RAD)
    first = np.where(angle < SMALL_RAD, 0.5 - angle**2 / 24, (1 - np.cos(large)) / large**2)
    second = np.where(angle < SMALL_RAD, 1 / 6 - angle**2 / 120, (large - np.sin(large)) / large**3)
    W = np.zeros((len(w), 3, 3))
    W[:, [2, 0, 1], [1, 2, 0]], W[:, [1, 2, 0], [2, 0, 1]] = w, -w
    swept: Array = np.eye(3) + first[:, None, None] * W + second[:, None, None] * W @ W
    return swept
