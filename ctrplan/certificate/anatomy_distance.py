"""Exact clearances of points and bodies of a scenario's robot, also of what lies between two points.

Between two points h apart an obstacle as thin as a wire comes nearer than at either. A point of clearance c stands for
the body within h / 2 of it, whose clearance is at least sqrt(c^2 - h^2 / 4). Where that is not enough, the body
between the points is looked at.

A base whose rotation is known within a ball turns every point about the base's origin, across its lever: along it the
point stays where it is. Two turns leave it no farther apart than they differ by, times the lever, and clearance changes
by no more than the point moves: a cover of the turns by squares bounds the least. Squares are halved where that may be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.parts import exact_clearance_of_many
from ctrplan.base.arrays import Array, lengths
from ctrplan.certificate.friction_states import POINT_SPACING_M
from ctrplan.scenario.scenario import anatomy_grid
from ctrplan.uncertainty.worst_case import BaseBall

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


TURNED_M = 0.1e-3  # [m] a tolerance: the least clearance over all turns is known within
QUARTERS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
GRID_SHARE = 0.03  # of a clearance by which the grid may be off far from surfaces (ctrplan.anatomy.clearance_grid)
HALF_M = POINT_SPACING_M / 2  # of the body around a point


@dataclass(frozen=True, eq=False)
class AnatomyDistance:
    """Clearance of points in the robot's frame beyond the anatomy's margins, however the base may be turned.

    The grid only tells which points are surely clear: it is within GRID_SHARE of itself and half a cell's diagonal of
    the truth.
    """

    scenario: Scenario
    grid: SignedDistanceField
    turn_rad: float = 0.0  # by how much the base may be turned about any axis

    @classmethod
    def of(cls, scenario: Scenario) -> AnatomyDistance | None:
        """None in free space."""
        grid = anatomy_grid(scenario)
        base = BaseBall.of(scenario.registration.position_sigma_m, scenario.registration.rotation_sigma_rad)
        return None if grid is None else cls(scenario, grid, base.rotation_rad)

    @property
    def as_registered(self) -> AnatomyDistance:
        """Distances of a base that stands where the scenario has it, not turned."""
        return replace(self, turn_rad=0.0)

    def __call__(self, points_m: Array, needed_m: Array) -> Array:
        """(K,) [m] at points (K, 3): exact where it may be below `needed_m` (K,), else a lower bound above that."""
        located = self.scenario.located(points_m)
        rough = self.grid.sample(located)
        result: Array = rough - self._doubt(rough) - self._reach(points_m)
        near = result < needed_m
        if near.any():
            result[near] = self._exact(points_m[near], needed_m[near])
        return result

    def _reach(self, points_m: Array) -> Array:
        """(K,) [m] no turn moves a point (K, 3) farther."""
        return np.asarray(self.turn_rad * lengths(points_m)) if self.turn_rad else np.zeros(len(points_m))

    def _exact(self, points_m: Array, needed_m: Array | None = None) -> Array:
        """(K,) [m] the least over all turns at points (K, 3), where it may be below `needed_m` (K,) within TURNED_M."""
        still = exact_clearance_of_many(self.scenario.anatomy, self.scenario.located(points_m))
        if not self.turn_rad:
            return still
        needed = np.full(len(still), np.inf) if needed_m is None else needed_m
        result = still - self._reach(points_m)
        rows = np.flatnonzero(result < needed)
        result[rows] = self._least_turned(points_m[rows], still[rows], needed[rows])
        return result

    def _least_turned(self, points_m: Array, still_m: Array, needed_m: Array) -> Array:
        """(K,) [m] lower bounds over all turns by squares of turns; still (K,) is what is left without a turn."""
        levers = lengths(points_m)
        along = points_m / np.maximum(levers, 1e-12)[:, None]
        first = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
        first /= np.maximum(lengths(first), 1e-12)[:, None]
        second, reach = np.cross(along, first), self._reach(points_m)
        owner, at, half = np.arange(len(levers)), np.zeros((len(levers), 2)), 1.0  # squares of turns, in the largest
        highest, least = still_m.copy(), np.full(len(levers), np.inf)
        while len(owner):
            half /= 2
            at = (at[:, None] + half * QUARTERS).reshape(-1, 2)
            owner = np.repeat(owner, len(QUARTERS))
            inside = lengths(np.maximum(np.abs(at) - half, 0.0)) <= 1
            at, owner = at[inside], owner[inside]
            turn = at / np.maximum(lengths(at), 1.0)[:, None]  # of a square's turns the nearest to its middle
            angle = self.turn_rad * lengths(turn)
            aside = turn[:, :1] * first[owner] + turn[:, 1:] * second[owner]
            aside *= (self.turn_rad * np.sinc(angle / np.pi))[:, None]
            turned = levers[owner, None] * (np.cos(angle)[:, None] * along[owner] + aside)
            clearance = exact_clearance_of_many(self.scenario.anatomy, self.scenario.located(turned))
            np.minimum.at(highest, owner, clearance)
            across = np.sqrt(2) * half * reach[owner]
            lower = clearance - across
            is_known = lower >= np.minimum(needed_m, highest - TURNED_M)[owner]
            is_known |= across <= TURNED_M
            np.minimum.at(least, owner[is_known], lower[is_known])
            owner, at = owner[~is_known], at[~is_known]
        return least

    def least(self, points_m: Array, radius_m: Array, owner: NDArray[np.intp], count: int) -> Array:
        """(count,) [m] smallest clearance of bodies, each the pieces around the points of one owner, exact.

        points (K, 3) in the order of their bodies, no farther than POINT_SPACING_M apart; radii (K,).
        """
        rough = self.grid.sample(self.scenario.located(points_m))
        doubt = self._doubt(rough) + self._reach(points_m)
        ceiling = self._ceilings(points_m, rough - radius_m, radius_m, owner, count)
        near = np.flatnonzero(clearance_of_segments(rough - doubt, HALF_M) - radius_m <= ceiling[owner])
        at_points = self._exact(points_m[near], ceiling[owner[near]] + radius_m[near] + HALF_M)
        least = np.full(count, np.inf)
        np.minimum.at(least, owner[near], at_points - radius_m[near])
        open_ = near[clearance_of_segments(at_points, HALF_M) - radius_m[near] < least[owner[near]]]
        begins = np.append(True, np.any(np.diff(points_m, axis=0) ** 2 > POINT_SPACING_M**2, axis=1))
        pieces = self._exact(around(points_m, open_, begins))
        values = clearance_of_segments(pieces, HALF_M / PARTS) - np.tile(radius_m[open_], PARTS)
        np.minimum.at(least, np.tile(owner[open_], PARTS), values)
        return least

    def _ceilings(self, points_m: Array, rough: Array, radius_m: Array, owner: NDArray[np.intp], count: int) -> Array:
        """(count,) [m] clearance of each owner where the grid says that it is least, exact; inf without points."""
        least, row = np.full(count, np.inf), np.full(count, -1)
        np.minimum.at(least, owner, rough)
        narrowest = np.flatnonzero(rough <= least[owner])[::-1]
        row[owner[narrowest]] = narrowest  # of several the first
        rows, ceiling = row[row >= 0], np.full(count, np.inf)
        ceiling[row >= 0] = self._exact(points_m[rows]) - radius_m[rows]
        return ceiling

    def near(self, points_m: Array, radius_m: Array) -> NDArray[np.intp]:
        """Indices of points (K, 3) with radii (K,) among which the one of least clearance surely is."""
        rough = self.grid.sample(self.scenario.located(points_m))
        doubt = self._doubt(rough) + self._reach(points_m)
        return np.flatnonzero(rough - doubt - radius_m <= (rough + doubt - radius_m).min())

    def _doubt(self, rough: Array) -> Array:
        doubt: Array = GRID_SHARE * np.abs(rough) + np.sqrt(3) / 2 * self.grid.spacing_m
        return doubt
