"""Exact clearances of points of a scenario's robot, where they matter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.parts import exact_clearance
from ctrplan.base.arrays import Array
from ctrplan.planning.motion import anatomy_grid

if TYPE_CHECKING:
    from ctrplan.anatomy.distance_field import SignedDistanceField
    from ctrplan.planning.scenario import Scenario

GRID_SHARE = 0.03  # of a clearance by which the grid may be off far from surfaces (ctrplan.anatomy.grid_distance)


@dataclass(frozen=True, eq=False)
class AnatomyDistance:
    """Clearance of points in the robot's frame beyond the anatomy's margins.

    The grid only tells which points are surely clear: it is within GRID_SHARE of itself and half a cell's diagonal of
    the truth.
    """

    scenario: Scenario
    grid: SignedDistanceField

    @classmethod
    def of(cls, scenario: Scenario) -> AnatomyDistance | None:
        """None in free space."""
        grid = anatomy_grid(scenario)
        return None if grid is None else cls(scenario, grid)

    def __call__(self, points_m: Array, needed_m: Array) -> Array:
        """(K,) [m] at points (K, 3): exact where it may be below `needed_m` (K,), else a lower bound above that."""
        located = points_m @ self.scenario.base_R.T + self.scenario.base_position_m
        rough = self.grid.sample(located)
        found: Array = rough - self._doubt(rough)
        near = found < needed_m
        if near.any():
            found[near] = exact_clearance(self.scenario.anatomy, located[near])
        return found

    def least(self, points_m: Array, radius_m: Array, owner: NDArray[np.intp], count: int) -> Array:
        """(count,) [m] smallest clearance of the bodies that points (K, 3) with radii (K,) belong to, exact."""
        located = points_m @ self.scenario.base_R.T + self.scenario.base_position_m
        rough = self.grid.sample(located)
        doubt = self._doubt(rough)
        ceiling = np.full(count, np.inf)
        np.minimum.at(ceiling, owner, rough + doubt - radius_m)
        near = rough - doubt - radius_m <= ceiling[owner]
        least = np.full(count, np.inf)
        np.minimum.at(least, owner[near], exact_clearance(self.scenario.anatomy, located[near]) - radius_m[near])
        return least

    def _doubt(self, rough: Array) -> Array:
        doubt: Array = GRID_SHARE * np.abs(rough) + np.sqrt(3) / 2 * self.grid.spacing_m
        return doubt
