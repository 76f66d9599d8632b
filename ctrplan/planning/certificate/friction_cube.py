"""The smallest clearance over all friction states of a configuration, not over the sign corners alone.

A friction state is a point phi of the cube [-1, 1]^P, one number per pair of tubes. Bodies are solved at corners and
middles of cells and interpolated multilinearly in between. In the middle of a cell the interpolation is compared with
the solved body; 1.5 times that difference, the largest one from the base up to a little beyond a point, is taken off
there. A cell whose clearance may lie below what is asked for is halved along every pair, up to DEPTH times.

The factor is an allowance and no proof: docs/planning.md says what was tried against it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

ERROR_FACTOR = 1.5  # times the difference in a cell's middle
BEYOND = 10  # points towards the tip whose difference counts too
DEPTH = 3  # halvings: 9 states along every pair
HALVINGS = 9  # of the states of one interpolated point

State = tuple[float, ...]
Solve = Callable[[Array], Array]  # friction states (S, P) -> bodies (S, N, 3); NaN where a solve failed
# Points (K, 3) and what is asked for (K,) [m] -> clearance beyond the anatomy's margins, exact where it is below that,
# else a lower bound of it.
Distance = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class LeastClearance:
    """What is known of the clearance over the whole cube."""

    lower_m: float  # if it is enough: no state has less; else what one may have; -inf where a state has no solution
    phi: State  # where the least was found, solved or interpolated
    point_m: Array  # (3,) the body's point there, robot frame
    solves: int  # states solved besides those that were known


@dataclass(frozen=True)
class _Cell:
    low: State
    high: State
    depth: int

    @property
    def middle(self) -> State:
        return tuple((a + b) / 2 for a, b in zip(self.low, self.high, strict=True))

    @property
    def corners(self) -> list[State]:
        """In the order of `_weights`: the last pair fastest, low before high."""
        return list(itertools.product(*zip(self.low, self.high, strict=True)))

    def halves(self) -> list[_Cell]:
        ends = list(zip(self.low, self.middle, self.high, strict=True))
        parts = itertools.product(*(((a, m), (m, b)) for a, m, b in ends))
        return [_Cell(tuple(p[0] for p in part), tuple(p[1] for p in part), self.depth + 1) for part in parts]


def least_clearance(
    known: dict[State, Array], radius_m: Array, solve: Solve, distance: Distance, enough_m: float
) -> LeastClearance:
    """Whether the clearance of all bodies reaches `enough_m`, cells being refined until it does or they are small.

    `known`: bodies (N, 3) of phi = 0 and of every sign corner; outer radii (N,). Bodies are looked at where they come
    near enough to the anatomy to matter.
    """
    pairs = len(next(iter(known)))
    least = LeastClearance(np.inf, (0.0,) * pairs, np.zeros(3), 0)
    cells, solves = [_Cell((-1.0,) * pairs, (1.0,) * pairs, 0)], 0
    while cells:
        wanted = list(dict.fromkeys(s for cell in cells for s in (*cell.corners, cell.middle) if s not in known))
        if wanted:
            known |= dict(zip(wanted, solve(np.array(wanted)), strict=True))
            solves += len(wanted)
        halved: list[_Cell] = []
        for cell in cells:
            found = _cell_clearance(cell, known, radius_m, distance, enough_m)
            if found.lower_m < enough_m and cell.depth < DEPTH and np.isfinite(found.lower_m):
                halved += cell.halves()
            elif found.lower_m < least.lower_m:
                least = found
        cells = halved
    return LeastClearance(least.lower_m, least.phi, least.point_m, solves)


def _cell_clearance(
    cell: _Cell, known: dict[State, Array], radius_m: Array, distance: Distance, enough_m: float
) -> LeastClearance:
    corners, middle = np.array([known[state] for state in cell.corners]), known[cell.middle]
    if not (np.all(np.isfinite(corners)) and np.all(np.isfinite(middle))):
        return LeastClearance(-np.inf, cell.middle, np.full(3, np.nan), 0)
    allowance = ERROR_FACTOR * _error(middle, corners.mean(axis=0)) + radius_m
    reach = np.linalg.norm(corners - middle, axis=2).max(axis=0)
    bound = distance(middle, enough_m + reach + allowance) - reach - allowance  # clearance is 1-Lipschitz
    rest, near = bound[bound >= enough_m].min(initial=np.inf), np.flatnonzero(bound < enough_m)
    lower, unit, point = _interpolated(corners[:, near], allowance[near], distance, enough_m)
    if rest < lower:
        return LeastClearance(float(rest), cell.middle, middle[int(np.argmin(bound))], 0)
    low, high = np.array(cell.low), np.array(cell.high)
    return LeastClearance(lower, tuple((low + unit * (high - low)).tolist()), point, 0)


def _interpolated(corners: Array, allowance: Array, distance: Distance, enough_m: float) -> tuple[float, Array, Array]:
    """Lower bound of the clearance of interpolated points, the state in the cell (P,), 0 to 1, and the point (3,).

    corners (2^P, N, 3), allowance (N,) taken off. Halves the states of each point until its clearance is enough or
    surely is not: a point moves no farther within a part of the cell than its corners' distances say.
    """
    pairs = int(np.log2(len(corners)))
    edges = _edges(corners, pairs)
    index, low, size = np.arange(corners.shape[1]), np.zeros((corners.shape[1], pairs)), 1.0
    least, at, place = np.inf, np.full(pairs, 0.5), np.zeros(3)
    for level in range(HALVINGS + 1):
        if not len(index):
            break
        unit = low + size / 2
        points = np.einsum("ac,cax->ax", _weights(unit), corners[:, index])
        slack = edges[index] * size / 2
        clear = distance(points, enough_m + allowance[index] + slack) - allowance[index]
        open_ = (clear - slack < enough_m) & (clear >= enough_m) & (level < HALVINGS)
        done = clear - np.where(clear < enough_m, 0.0, slack)  # a value below what is asked for says enough
        k = int(np.argmin(np.where(open_, np.inf, done)))
        if not open_[k] and done[k] < least:
            least, at, place = float(done[k]), unit[k], points[k]
        if least < enough_m:
            break
        index, size = np.repeat(index[open_], 2**pairs), size / 2
        low = (low[open_][:, None] + size * _signs(pairs)).reshape(-1, pairs)
    return least, at, place


def _error(solved: Array, interpolated: Array) -> Array:
    """(N,) [m] largest difference from the base up to BEYOND points further out."""
    apart = np.maximum.accumulate(np.linalg.norm(solved - interpolated, axis=1))
    return np.asarray(apart[np.minimum(np.arange(len(apart)) + BEYOND, len(apart) - 1)])


def _edges(corners: Array, pairs: int) -> Array:
    """(N,) [m] how far a point can move over the cell: the longest edges of every pair, added up."""
    grid = corners.reshape(*(2,) * pairs, *corners.shape[1:])
    others = tuple(range(pairs - 1))
    total: Array = np.sum(
        [
            np.linalg.norm(np.take(grid, 1, axis) - np.take(grid, 0, axis), axis=-1).max(axis=others)
            for axis in range(pairs)
        ],
        axis=0,
    )
    return total


def _weights(unit: Array) -> Array:
    """(A, 2^P) multilinear weights of a cell's corners at states (A, P), 0 to 1."""
    signs = _signs(unit.shape[1])
    weights: Array = np.prod(np.where(signs > 0, unit[:, None], 1 - unit[:, None]), axis=2)
    return weights


@cache
def _signs(pairs: int) -> NDArray[np.float64]:
    return np.array(list(itertools.product((0.0, 1.0), repeat=pairs)))


def corner_states(pairs: int) -> Sequence[State]:
    """Friction states of the sign corners in the order of `Bound.corners`."""
    return list(itertools.product((1.0, -1.0), repeat=pairs))
