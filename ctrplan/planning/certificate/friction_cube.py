"""The least clearance, the least stability and the largest strain over all friction states of a configuration.

A friction state is a point phi of the cube [-1, 1]^P, one number per pair of tubes. Robots are solved at corners and
middles of cells and interpolated multilinearly in between. In the middle of a cell the interpolation is compared with
the solved robot; 1.5 times that difference is taken off what the cell's corners have. Of bodies the largest difference
from the base up to a little beyond a point counts there. A cell in which less may be left than is asked for is halved
along every pair, up to DEPTH times.

The factor is an allowance and no proof: docs/certificate.md says what was tried against it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.planning.certificate.allowances import POINT_SPACING_M
from ctrplan.planning.certificate.body_pieces import PARTS, around, beside
from ctrplan.robot.robot import Robot

ERROR_FACTOR = 1.5  # times the difference in a cell's middle
BEYOND = 10  # points towards the tip whose difference counts too
DEPTH = 3  # halvings: 9 states along every pair
LEAST_DEPTH = 1  # the middle of the cube alone is where errors may vanish by symmetry, beside a fold
NUMBERS_DEPTH = 6  # where only stability or strain ask for them: near a fold both bend sharply
MOST_TUBES = 6  # whose cube, halved once, has 275 corners and middles; of seven 793
HALVINGS = 9  # of the states of one interpolated point
HALF_M = POINT_SPACING_M / 2  # of the body around a point
PIECE_M = HALF_M / PARTS  # of a piece around its middle

State = tuple[float, ...]
# Points (K, 3) and what is asked for (K,) [m] -> clearance beyond the anatomy's margins, exact where it is below that,
# else a lower bound of it.
Distance = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class Solved:
    """A robot in one friction state."""

    body_m: Array  # (N, 3) NaN where no equilibrium was found
    stability: float
    max_strain: float


Solve = Callable[[Array], Sequence[Solved]]  # of friction states (S, P)


@dataclass(frozen=True)
class Needed:
    """What every friction state has to keep; no cell is halved to know more."""

    clearance_m: float
    stability: float = -np.inf
    max_strain: float = np.inf


@dataclass(frozen=True, eq=False)
class LeastOfStates:
    """What is known of all states: if it is what was asked for, none has less; else what one may have."""

    clearance_m: float  # -inf where a state has no equilibrium
    stability: float
    max_strain: float
    phi: State  # where the least clearance was found, solved or interpolated
    point_m: Array  # (3,) the body's point there, robot frame
    solves: int  # states solved besides those that were known

    def with_less_of(self, other: LeastOfStates) -> LeastOfStates:
        """The worse of both in each respect."""
        nearer = other if other.clearance_m < self.clearance_m else self
        return LeastOfStates(
            nearer.clearance_m,
            min(self.stability, other.stability),
            max(self.max_strain, other.max_strain),
            nearer.phi,
            nearer.point_m,
            self.solves + other.solves,
        )

    def keeps(self, needed: Needed) -> bool:
        """Whether nothing less than needed is left."""
        return (
            self.clearance_m >= needed.clearance_m
            and self.stability >= needed.stability
            and self.max_strain <= needed.max_strain
        )


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


def refuse_many_tubes(robot: Robot) -> None:
    """Raises InputError for a robot with more friction states than can be looked at."""
    if robot.n > MOST_TUBES:
        rule = f"has {robot.n} tubes: certificates look at every friction state of at most {MOST_TUBES}"
        raise InputError(rule, file=robot.path, key="tube")


def least_of_states(
    known: dict[State, Solved],
    radius_m: Array,
    solve: Solve,
    distance: Distance | None,
    needed: Needed,
    depth: int = DEPTH,
    least_depth: int = LEAST_DEPTH,
) -> LeastOfStates:
    """Whether every state keeps what is needed, cells being halved until they do, `depth` times at most.

    All cells are halved `least_depth` times.

    `known`: phi = 0 and every sign corner; outer radii (N,). Bodies are looked at where they come near enough to the
    anatomy to matter, not at all without a `distance`.
    """
    pairs = len(next(iter(known)))
    least = LeastOfStates(np.inf, np.inf, -np.inf, (0.0,) * pairs, np.zeros(3), 0)
    cells = [_Cell((-1.0,) * pairs, (1.0,) * pairs, 0)]
    while cells:
        wanted = list(dict.fromkeys(s for cell in cells for s in (*cell.corners, cell.middle) if s not in known))
        if wanted:
            known |= dict(zip(wanted, solve(np.array(wanted)), strict=True))
            least = replace(least, solves=least.solves + len(wanted))
        halved: list[_Cell] = []
        for cell in cells:
            found = _cell(cell, known, radius_m, distance, needed)
            deepest = max(depth, least_depth) if found.clearance_m < needed.clearance_m else NUMBERS_DEPTH
            is_open = cell.depth < least_depth or not found.keeps(needed)
            if is_open and cell.depth < deepest and np.isfinite(found.stability):
                halved += cell.halves()
            else:
                least = least.with_less_of(found)
        cells = halved
    return least


def _cell(
    cell: _Cell, known: dict[State, Solved], radius_m: Array, distance: Distance | None, needed: Needed
) -> LeastOfStates:
    corners, middle = [known[state] for state in cell.corners], known[cell.middle]
    bodies = np.array([corner.body_m for corner in corners])
    if not (np.all(np.isfinite(bodies)) and np.all(np.isfinite(middle.body_m))):
        return LeastOfStates(-np.inf, -np.inf, np.inf, cell.middle, np.full(3, np.nan), 0)
    stability = -_most([-corner.stability for corner in corners], -middle.stability)
    strain = _most([corner.max_strain for corner in corners], middle.max_strain)
    lower, phi, point = np.inf, cell.middle, middle.body_m[-1]
    if distance is not None:
        lower, phi, point = _cell_clearance(cell, bodies, middle.body_m, radius_m, distance, needed.clearance_m)
    return LeastOfStates(lower, stability, strain, phi, point, 0)


def _most(corners: list[float], middle: float) -> float:
    """What a number may rise to over a cell; inf where one is not known."""
    most = max(*corners, middle) + ERROR_FACTOR * abs(middle - float(np.mean(corners)))
    return most if np.isfinite(most + float(np.sum(corners))) else np.inf


def _cell_clearance(
    cell: _Cell, corners: Array, middle: Array, radius_m: Array, distance: Distance, enough_m: float
) -> tuple[float, State, Array]:
    """Lower bound of the clearance of bodies in the cell, the state, and the point (3,) that has it."""
    allowance = ERROR_FACTOR * _error(middle, corners.mean(axis=0)) + radius_m
    reach = np.linalg.norm(corners - middle, axis=2).max(axis=0)
    far = beside(distance(middle, enough_m + reach + allowance + HALF_M), HALF_M)
    bound = far - reach - allowance  # clearance is 1-Lipschitz
    rest, near = bound[bound >= enough_m].min(initial=np.inf), np.flatnonzero(bound < enough_m)
    pieces, off = around(corners, near), np.tile(allowance[near], PARTS)
    lower, unit, point = _interpolated(pieces, off, distance, enough_m)
    if rest < lower:
        return float(rest), cell.middle, middle[int(np.argmin(bound))]
    low, high = np.array(cell.low), np.array(cell.high)
    return lower, tuple((low + unit * (high - low)).tolist()), point


def _interpolated(corners: Array, allowance: Array, distance: Distance, enough_m: float) -> tuple[float, Array, Array]:
    """Lower bound of the clearance of interpolated points, the state in the cell (P,), 0 to 1, and the point (3,).

    corners (2^P, N, 3) of pieces of the body, allowance (N,) taken off. Halves the states of each point until its
    clearance is enough or surely is not: a point moves no farther within a part of the cell than its corners' distances
    say.
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
        clear = beside(distance(points, enough_m + allowance[index] + slack + PIECE_M), PIECE_M) - allowance[index]
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
