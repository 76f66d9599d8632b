"""Clearance on a regular grid, sampled trilinearly as the core does."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
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
        for corner in np.ndindex(2, 2, 2):
            share = np.where(corner, weight, 1.0 - weight).prod(axis=1)
            result += share * self.values_m[tuple((node + corner).T)]
        return np.asarray(result)

    def interpolation_error_m(self, band_m: float = 0.01, count: int = 20_000, seed: int = 0) -> float:
        """Largest overestimate of the clearance [m] found at `count` random points that `sample` calls clear.

        The points lie within a grid step of nodes with a clearance of 0 to band_m [m], where paths are decided; where
        there are none, anywhere clear; 0.0 where nothing is clear. Underestimates (near the medial axis) cost room but
        are safe and are not counted.
        """
        rng = np.random.default_rng(seed)
        candidates = np.flatnonzero((self.values_m >= 0) & (self.values_m <= band_m))
        if not candidates.size:
            candidates = np.flatnonzero(self.values_m >= 0)
        if not candidates.size:
            return 0.0
        node = np.stack(np.unravel_index(rng.choice(candidates, count), self.values_m.shape), axis=1)
        points = self.origin_m + self.spacing_m * (node + rng.uniform(-1, 1, (count, 3)))
        points = np.clip(points, self.origin_m, self.upper_m)
        sampled = self.sample(points)
        points, sampled = points[sampled >= 0], sampled[sampled >= 0]
        return float(np.max(sampled - exact_clearance(self.parts, points), initial=0.0))
