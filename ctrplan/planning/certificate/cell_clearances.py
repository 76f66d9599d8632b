"""The least clearance of bodies in cells of friction states.

Bodies are interpolated multilinearly between a cell's corners. In its middle the interpolation is compared with the
solved robot; ERROR_FACTOR times the largest difference from the base up to a little beyond a point is taken off there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.mechanics.friction_cells import Distance, cell_spread, least_of_points
from ctrplan.planning.certificate.allowances import POINT_SPACING_M
from ctrplan.planning.certificate.body_pieces import PARTS, beside
from ctrplan.planning.certificate.friction_states import Cell, State

ERROR_FACTOR = 1.5  # times the difference in a cell's middle
SUSPECTS = 1  # points of a cell that are looked at first: one that is too near tells enough of most cells
BEYOND = 10  # points towards the tip whose difference counts too
HALVINGS = 9  # of the states of one interpolated point, along every pair
HALF_M = POINT_SPACING_M / 2  # of the body around a point
PIECE_M = HALF_M / PARTS  # of a piece around its middle


@dataclass(frozen=True, eq=False)
class CellClearance:
    """A lower bound: if it is what was asked for, no body of the cell has less."""

    clearance_m: float
    phi: State  # where it was found
    point_m: Array  # (3,) the body's point there, robot frame


def cell_clearances(
    cells: Sequence[Cell],
    bodies: Array,
    distance: Distance,
    enough_m: Array,
    is_least_asked: NDArray[np.bool_],
) -> list[CellClearance]:
    """Of L cells, for each of which `enough_m` (L,) is asked.

    Bodies (L, 2^P + 1, N, 4) of corners and middle: points, and radii that have to be clear. Of cells that have less
    than enough the least is found where it is asked for (L,), else some clearance that is not enough.
    """
    middles = bodies[:, -1]
    count, points = middles.shape[:2]
    apart, reach = cell_spread(bodies, BEYOND)
    error = ERROR_FACTOR * apart
    away = reach + error + middles[..., 3]
    asked = (enough_m[:, None] + away + HALF_M).ravel()
    far = beside(distance(middles[..., :3].reshape(-1, 3), asked), HALF_M).reshape(count, points)
    bound = far - away  # clearance is 1-Lipschitz
    rest = np.where(bound >= enough_m[:, None], bound, np.inf)
    spare = (bound - enough_m[:, None]).ravel()
    suspects, others = _by_suspicion(np.flatnonzero(spare < 0), spare, points)
    closest = _closest(bodies, error, suspects, distance, enough_m)
    is_known = ~is_least_asked & [k in closest and closest[k][0] < enough_m[k] for k in range(count)]
    for k, row in _closest(bodies, error, others[~is_known[others // points]], distance, enough_m).items():
        if k not in closest or row[0] < closest[k][0]:
            closest[k] = row
    found = []
    for k, cell in enumerate(cells):
        at = int(np.argmin(rest[k]))
        least = CellClearance(float(rest[k, at]), cell.middle, middles[k, at, :3])
        if k in closest and closest[k][0] <= least.clearance_m:
            clearance, unit, place = closest[k]
            least = CellClearance(clearance, cell.at(unit), place)
        found.append(least)
    return found


def _by_suspicion(near: NDArray[np.intp], spare: Array, points: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Points `near` of cells of `points` each: the SUSPECTS of every cell with the least to spare, and the others."""
    ordered = near[np.lexsort((spare[near], near // points))]
    owner = ordered // points
    rank = np.arange(len(ordered)) - np.searchsorted(owner, owner)
    return np.sort(ordered[rank < SUSPECTS]), np.sort(ordered[rank >= SUSPECTS])


def _closest(
    bodies: Array, error: Array, near: NDArray[np.intp], distance: Distance, enough_m: Array
) -> dict[int, tuple[float, Array, Array]]:
    """Of cells with points `near`, counted over all of them: least clearance, state in the cell (P,), place (3,).

    Points come first; where one is not enough for the body around it, that is looked at in parts.
    """
    if not len(near):
        return {}
    points = bodies.shape[2]
    rough = least_of_points(bodies, near, error, enough_m, distance, parts=1, half_m=HALF_M, halvings=HALVINGS)
    is_rough = rough[0] >= enough_m[near // points]
    narrow = near[~is_rough]
    closer = least_of_points(bodies, narrow, error, enough_m, distance, parts=PARTS, half_m=PIECE_M, halvings=HALVINGS)
    lower, unit, place = (np.concatenate([a[is_rough], b]) for a, b in zip(rough, closer, strict=True))
    owner = np.concatenate([near[is_rough], np.tile(narrow, PARTS)]) // points
    order = np.lexsort((lower, owner))
    cells, first = np.unique(owner[order], return_index=True)
    rows = zip(cells.tolist(), order[first].tolist(), strict=True)
    return {cell: (float(lower[k]), unit[k], place[k]) for cell, k in rows}
