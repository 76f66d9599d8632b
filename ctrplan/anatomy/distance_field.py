"""Clearance on a regular grid, sampled trilinearly by the core."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
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
        points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
        origin = np.ascontiguousarray(self.origin_m, dtype=np.float64)
        grid = _model.Grid(
            values=self.values_m, origin=origin, spacing=self.spacing_m, R_AB=np.eye(3), p_AB=np.zeros(3)
        )
        return np.asarray(grid.sample(points))
