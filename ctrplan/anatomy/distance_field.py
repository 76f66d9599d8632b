"""Clearance on a regular grid, sampled trilinearly as the core does."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.base.arrays import Array

Grid = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SignedDistanceField:
    """Clearance on a regular grid: node (i, j, k) stands at origin_m + spacing_m * (i, j, k).

    origin_m (3,) [m]; values_m (nx, ny, nz) float32, C order [m], see `exact_clearance` for the quantity;
    parts: what it was built from, for measuring its error.
    """

    origin_m: Array
    spacing_m: float
    values_m: Grid
    parts: tuple[AnatomyPart, ...] = field(default=(), repr=False)

    @property
    def upper_m(self) -> Array:
        """The corner (3,) opposite to origin_m [m]."""
        return np.asarray(self.origin_m + self.spacing_m * (np.array(self.values_m.shape) - 1))

    def sample(self, points_m: ArrayLike) -> Array:
        """Trilinear clearance (K,) [m] at points (K, 3) [m].

        Outside the grid: the value at the nearest point of the grid's box minus the distance to it, a lower bound since
        clearance is 1-Lipschitz.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        top = np.array(self.values_m.shape) - 1
        position = (points - self.origin_m) / self.spacing_m
        clamped = np.clip(position, 0, top)
        node = np.minimum(clamped.astype(np.int64), top - 1)
        weight = clamped - node
        result = -self.spacing_m * np.linalg.norm(position - clamped, axis=1)
        strides = np.array([self.values_m.shape[1] * self.values_m.shape[2], self.values_m.shape[2], 1])
        values, first = self.values_m.reshape(-1), node @ strides
        sides = 1.0 - weight, weight
        for i, j, k in np.ndindex(2, 2, 2):
            share = sides[i][:, 0] * sides[j][:, 1] * sides[k][:, 2]
            result += share * values[first + (i * strides[0] + j * strides[1] + k)]
        return np.asarray(result)
