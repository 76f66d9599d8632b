"""The least clearance of bodies in cells of friction states.

Bodies are interpolated multilinearly between a cell's corners. In its middle the interpolation is compared with the
solved robot; ERROR_FACTOR times the largest difference from the base up to a little beyond a point is taken off there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.planning.certificate.allowances import POINT_SPACING_M
from ctrplan.planning.certificate.body_pieces import PARTS, around, beside
from ctrplan.planning.certificate.friction_states import Cell, State, unit_weights

ERROR_FACTOR = 1.5  # times the difference in a cell's middle
SUSPECTS = 1  # points of a cell that are looked at first: one that is too near tells enough of most cells
BEYOND = 10  # points towards the tip whose difference counts too
HALVINGS = 9  # of the states of one interpolated point, along every pair
HALF_M = POINT_SPACING_M / 2  # of the body around a point
PIECE_M = HALF_M / PARTS  # of a piece around its middle

# Points (K, 3) and what is asked for (K,) [m] -> clearance beyond the anatomy's margins, exact where it is below that,
# else a lower bound of it.
Distance = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class CellClearance:
    """A lower bound: if it is what was asked for, no body of the cell has less."""

    clearance_m: float
    phi: State  # where it was found
    point_m: Array  # (3,) the body's point there, robot frame


def cell_clearances(
    cells: Sequence[Cell],
    corners: Array,
    middles: Array,
    distance: Distance,
    enough_m: Array,
    is_least_asked: NDArray[np.bool_],
) -> list[CellClearance]:
    """Of L cells, for each of which `enough_m` (L,) is asked.

    Corners' bodies (L, 2^P, N, 4) and middles' (L, N, 4): points, and radii that have to be clear. Of cells that have
    less than enough the least is found where it is asked for (L,), else some clearance that is not enough.
    """
    count, points = middles.shape[:2]
    error = ERROR_FACTOR * most_up_to(np.linalg.norm((middles - corners.mean(axis=1))[..., :3], axis=2))
    away = corners - middles[:, None]
    reach = (np.linalg.norm(away[..., :3], axis=3) + away[..., 3]).max(axis=1)
    off = error + middles[..., 3]
    asked = (enough_m[:, None] + reach + off + HALF_M).ravel()
    far = beside(distance(middles[..., :3].reshape(-1, 3), asked), HALF_M).reshape(count, points)
    bound = far - reach - off  # clearance is 1-Lipschitz
    rest = np.where(bound >= enough_m[:, None], bound, np.inf)
    spare = (bound - enough_m[:, None]).ravel()
    suspects, others = _by_suspicion(np.flatnonzero(spare < 0), spare, points)
    closest = _closest(corners, error, suspects, distance, enough_m)
    is_known = ~is_least_asked & [k in closest and closest[k][0] < enough_m[k] for k in range(count)]
    for k, row in _closest(corners, error, others[~is_known[others // points]], distance, enough_m).items():
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
    corners: Array, error: Array, near: NDArray[np.intp], distance: Distance, enough_m: Array
) -> dict[int, tuple[float, Array, Array]]:
    """Of cells with points `near`, counted over all of them: least clearance, state in the cell (P,), place (3,)."""
    count, _, points, _ = corners.shape
    along = corners.transpose(1, 0, 2, 3).reshape(-1, count * points, 4)
    error, enough = error.ravel(), enough_m[near // points]
    rough = _interpolated(along[:, near], error[near], HALF_M, distance, enough)
    is_rough = rough[0] >= enough
    narrow, short = near[~is_rough], enough[~is_rough]
    pieces = around(along, narrow, np.arange(count * points) % points == 0)
    closer = _interpolated(pieces, np.tile(error[narrow], PARTS), PIECE_M, distance, np.tile(short, PARTS))
    lower, unit, place = (np.concatenate([a[is_rough], b]) for a, b in zip(rough, closer, strict=True))
    owner = np.concatenate([near[is_rough], np.tile(narrow, PARTS)]) // points
    order = np.lexsort((lower, owner))
    cells, first = np.unique(owner[order], return_index=True)
    rows = zip(cells.tolist(), order[first].tolist(), strict=True)
    return {cell: (float(lower[k]), unit[k], place[k]) for cell, k in rows}


def _interpolated(
    corners: Array, error: Array, half_m: float, distance: Distance, enough_m: Array
) -> tuple[Array, Array, Array]:
    """(K,) lower bounds of the clearance of points of bodies, (K, P) states in the cell, 0 to 1, (K, 3) where.

    corners (2^P, K, 4) of points with radii, each for `half_m` of the body on both sides; errors (K,) taken off; what
    is asked of each (K,). Halves the states of each point, along the pair that moves it most, until its clearance is
    enough or surely is not: a point moves no farther within a part of the cell than its corners' distances say.
    """
    pairs = int(np.log2(len(corners)))
    edges, count = _edges(corners, pairs), corners.shape[1]
    index, low, size = np.arange(count), np.zeros((count, pairs)), np.ones((count, pairs))
    least, at, place = np.full(count, np.inf), np.full((count, pairs), 0.5), np.zeros((count, 3))
    for level in range(HALVINGS * pairs + 1):
        if not len(index):
            break
        unit, moves, enough = low + size / 2, edges[index] * size, enough_m[index]
        points = np.einsum("ac,cax->ax", unit_weights(unit), corners[:, index])
        off, slack = error[index] + points[:, 3], moves.sum(axis=1) / 2
        clear = beside(distance(points[:, :3], enough + off + slack + half_m), half_m) - off
        open_ = (clear - slack < enough) & (clear >= enough) & (level < HALVINGS * pairs)
        done = np.flatnonzero(~open_)
        # less than asked for says enough
        values = clear[done] - np.where(clear[done] < enough[done], 0.0, slack[done])
        order = np.argsort(-values, kind="stable")  # the least of a point last, so that it stays
        order = order[values[order] < least[index[done[order]]]]
        done, values = done[order], values[order]
        least[index[done]], at[index[done]], place[index[done]] = values, unit[done], points[done, :3]
        go_on = open_ & (least[index] >= enough)
        index, low, size = _halved(index[go_on], low[go_on], size[go_on], moves[go_on])
    return least, at, place


def _halved(index: NDArray[np.intp], low: Array, size: Array, moves: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Boxes of states (A, P), each in two along the pair whose states move the point most."""
    along = np.eye(low.shape[1])[np.argmax(moves, axis=1)]
    size = size * (1 - along / 2)
    return np.tile(index, 2), np.concatenate([low, low + along * size]), np.tile(size, (2, 1))


def most_up_to(apart_m: Array) -> Array:
    """(..., N) [m] of distances at points the largest from the base up to BEYOND points further out."""
    most: Array = np.maximum.accumulate(apart_m, axis=-1)
    count = most.shape[-1]
    return most[..., np.minimum(np.arange(count) + BEYOND, count - 1)]


def _edges(corners: Array, pairs: int) -> Array:
    """(N, P) [m] how far a point's surface can move over the cell by each pair: the longest edges, radii counted."""
    grid = corners.reshape(*(2,) * pairs, *corners.shape[1:])
    others = tuple(range(pairs - 1))
    apart = (np.take(grid, 1, axis) - np.take(grid, 0, axis) for axis in range(pairs))
    return np.stack([(np.linalg.norm(d[..., :3], axis=-1) + np.abs(d[..., 3])).max(axis=others) for d in apart], axis=1)
