"""Exact clearances of points and bodies of a scenario's robot, also of what lies between two points.

Between two points h apart an obstacle as thin as a wire comes nearer than at either. A point of clearance c stands for
for the body within h / 2 of it, whose clearance is at least sqrt(c^2 - h^2 / 4). Where that is not enough, the body
between the points is looked at.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.parts import exact_clearance_of_many
from ctrplan.base.arrays import Array
from ctrplan.certificate.friction_states import POINT_SPACING_M
from ctrplan.scenario.scenario import anatomy_grid

if TYPE_CHECKING:
    from ctrplan.anatomy.clearance_grid import SignedDistanceField
    from ctrplan.scenario.scenario import Scenario

PARTS = 4  # of the body around a point


def clearance_of_segments(clearance_m: Array, half_m: float) -> Array:
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


GRID_SHARE = 0.03  # of a clearance by which the grid may be off far from surfaces (ctrplan.anatomy.clearance_grid)
HALF_M = POINT_SPACING_M / 2


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
        located = self.scenario.located(points_m)
        rough = self.grid.sample(located)
        result: Array = rough - self._doubt(rough)
        near = result < needed_m
        if near.any():
            result[near] = exact_clearance_of_many(self.scenario.anatomy, located[near])
        return result

    def least(self, points_m: Array, radius_m: Array, owner: NDArray[np.intp], count: int) -> Array:
        """(count,) [m] smallest clearance of bodies, each the pieces around the points of one owner, exact.

        points (K, 3) in the order of their bodies, no farther than POINT_SPACING_M apart; radii (K,).
        """
        located = self.scenario.located(points_m)
        rough = self.grid.sample(located)
        doubt = self._doubt(rough)
        ceiling = self._ceilings(located, rough - radius_m, radius_m, owner, count)
        near = np.flatnonzero(clearance_of_segments(rough - doubt, HALF_M) - radius_m <= ceiling[owner])
        at_points = exact_clearance_of_many(self.scenario.anatomy, located[near])
        least = np.full(count, np.inf)
        np.minimum.at(least, owner[near], at_points - radius_m[near])
        open_ = near[clearance_of_segments(at_points, HALF_M) - radius_m[near] < least[owner[near]]]
        begins = np.append(True, np.any(np.diff(located, axis=0) ** 2 > POINT_SPACING_M**2, axis=1))
        pieces = exact_clearance_of_many(self.scenario.anatomy, around(located, open_, begins))
        values = clearance_of_segments(pieces, HALF_M / PARTS) - np.tile(radius_m[open_], PARTS)
        np.minimum.at(least, np.tile(owner[open_], PARTS), values)
        return least

    def _ceilings(self, located: Array, rough: Array, radius_m: Array, owner: NDArray[np.intp], count: int) -> Array:
        """(count,) [m] clearance of each owner where the grid says that it is least, exact; inf without points."""
        least, row = np.full(count, np.inf), np.full(count, -1)
        np.minimum.at(least, owner, rough)
        narrowest = np.flatnonzero(rough <= least[owner])[::-1]
        row[owner[narrowest]] = narrowest  # of several the first
        rows, ceiling = row[row >= 0], np.full(count, np.inf)
        ceiling[row >= 0] = exact_clearance_of_many(self.scenario.anatomy, located[rows]) - radius_m[rows]
        return ceiling

    def near(self, points_m: Array, radius_m: Array) -> NDArray[np.intp]:
        """Indices of points (K, 3) with radii (K,) among which the one of least clearance surely is."""
        rough = self.grid.sample(self.scenario.located(points_m))
        doubt = self._doubt(rough)
        return np.flatnonzero(rough - doubt - radius_m <= (rough + doubt - radius_m).min())

    def _doubt(self, rough: Array) -> Array:
        doubt: Array = GRID_SHARE * np.abs(rough) + np.sqrt(3) / 2 * self.grid.spacing_m
        return doubt
