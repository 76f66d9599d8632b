"""The least clearance, the least stability and the largest strain over all friction states of a configuration.

Bodies are interpolated multilinearly between a cell's corners. In its middle the interpolation is compared with the
solved robot; ERROR_FACTOR times the largest difference from the base up to a little beyond a point is taken off there.

In the middle of a cell the multilinear interpolation of its corners is compared with the solved robot; ERROR_FACTOR
times that difference is taken off what the corners have. The factor is an allowance and no proof: docs/certificate.md
says what was tried against it.

A friction state is a point phi of the cube [-1, 1]^P, one number per pair of tubes. Robots are solved at corners and
middles of cells and interpolated multilinearly in between (`cell_bounds.py`). A cell in which less may be left than is
asked for is halved along every pair, up to DEPTH times. Many configurations are looked at at once: there is little to
compute of each.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.certificate.anatomy_distance import HALF_M, PARTS, clearance_of_segments
from ctrplan.certificate.friction_states import Cell, Solved, State
from ctrplan.errors import InputError
from ctrplan.mechanics.friction import Distance, cell_bodies, cell_spread, nearest_points
from ctrplan.robot.robot import Robot


@dataclass(frozen=True)
class Needed:
    """What every friction state has to keep; no cell is halved to know more."""

    clearance_m: float
    stability: float = -np.inf
    max_strain: float = np.inf


@dataclass(frozen=True, eq=False)
class StateMinima:
    """What is known of all states: if it is what was asked for, none has less; else what one may have."""

    clearance_m: float  # -inf where a state has no equilibrium
    stability: float
    max_strain: float
    phi: State  # where the least clearance was found, solved or interpolated
    point_m: Array  # (3,) the body's point there, robot frame
    solves: int  # states solved besides those that were known

    def with_less_of(self, other: StateMinima) -> StateMinima:
        """The worse of both in each respect."""
        nearer = other if other.clearance_m < self.clearance_m else self
        return StateMinima(
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


ERROR_FACTOR = 1.5  # times the difference in a cell's middle
BEYOND = 10  # points towards the tip whose difference counts too
WITHIN_M = 1e-5  # [m] a tolerance: states of an interpolated point are looked at no closer than they move it
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
    lengths: NDArray[np.int_],
    distance: Distance,
    enough_m: Array,
    is_least_asked: NDArray[np.bool_],
) -> list[CellClearance]:
    """The clearances of L cells, for each of which `enough_m` (L,) is required.

    Bodies (L, 2^P + 1, N, 4) of corners and middle: points, and radii that have to be clear; each cell's own points are
    the first `lengths` (L,) of them. Of cells that have less than enough the least is found where it is asked for (L,),
    else some clearance that is not enough.
    """
    middles = bodies[:, -1]
    count, points = middles.shape[:2]
    apart, reach = cell_spread(bodies, BEYOND)
    error = ERROR_FACTOR * apart
    away = reach + error + middles[..., 3]
    far_enough = enough_m[:, None] + away + HALF_M
    own = np.arange(points) < lengths[:, None]
    bound = np.full((count, points), np.inf)
    far = clearance_of_segments(distance(middles[own][:, :3], far_enough[own]), HALF_M)
    bound[own] = far - away[own]  # clearance is 1-Lipschitz
    rest = np.where(bound >= enough_m[:, None], bound, np.inf)
    spare = (bound - enough_m[:, None]).ravel()
    suspects, others = _by_suspicion(np.flatnonzero(spare < 0), spare, points)
    closest = _closest(bodies, error, suspects, distance, enough_m)
    is_known = ~is_least_asked & [k in closest and closest[k][0] < enough_m[k] for k in range(count)]
    for k, row in _closest(bodies, error, others[~is_known[others // points]], distance, enough_m).items():
        if k not in closest or row[0] < closest[k][0]:
            closest[k] = row
    results = []
    for k, cell in enumerate(cells):
        at = int(np.argmin(rest[k]))
        least = CellClearance(float(rest[k, at]), cell.middle, middles[k, at, :3])
        if k in closest and closest[k][0] <= least.clearance_m:
            clearance, unit, place = closest[k]
            least = CellClearance(clearance, cell.at(unit), place)
        results.append(least)
    return results


def _by_suspicion(near: NDArray[np.intp], spare: Array, points: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Points `near` of cells of `points` each: of every cell the one with the least to spare, and the others.

    One that is too near tells enough of most cells.
    """
    ordered = near[np.lexsort((spare[near], near // points))]
    is_first = np.diff(ordered // points, prepend=-1) > 0
    return np.sort(ordered[is_first]), np.sort(ordered[~is_first])


def _closest(
    bodies: Array, error: Array, near: NDArray[np.intp], distance: Distance, enough_m: Array
) -> dict[int, tuple[float, Array, Array]]:
    """The nearest of cells with points `near`, counted over all: least clearance, state in the cell (P,), place (3,).

    Points come first; where one is not enough for the body around it, that is looked at in parts.
    """
    if not len(near):
        return {}
    points = bodies.shape[2]
    rough = nearest_points(bodies, near, error, enough_m, distance, parts=1, half_m=HALF_M, within_m=WITHIN_M)
    is_rough = rough[0] >= enough_m[near // points]
    narrow = near[~is_rough]
    closer = nearest_points(bodies, narrow, error, enough_m, distance, parts=PARTS, half_m=PIECE_M, within_m=WITHIN_M)
    lower, unit, place = (np.concatenate([a[is_rough], b]) for a, b in zip(rough, closer, strict=True))
    owner = np.concatenate([near[is_rough], np.tile(narrow, PARTS)]) // points
    order = np.lexsort((lower, owner))
    cells, first = np.unique(owner[order], return_index=True)
    rows = zip(cells.tolist(), order[first].tolist(), strict=True)
    return {cell: (float(lower[k]), unit[k], place[k]) for cell, k in rows}


@dataclass(frozen=True, eq=False)
class CellQuery:
    """A cell with its robots."""

    cell: Cell
    solved: Sequence[Solved]  # of its 2^P corners, then of its middle
    radius_m: Array  # (N,) outer radii
    enough_m: float | None  # clearance that is asked for; None if none is
    is_least_asked: bool = True  # also where it is not enough

    @property
    def has_bodies(self) -> bool:
        """Whether all of its states have an equilibrium."""
        return all(state.has_body for state in self.solved)


def cell_minima(queries: Sequence[CellQuery], distance: Distance | None) -> list[StateMinima]:
    """The minima of L cells; clearance is inf where it was not required, or without a `distance`."""
    stability = -_most(np.array([[-state.stability for state in cell.solved] for cell in queries]))
    strain = _most(np.array([[state.max_strain for state in cell.solved] for cell in queries]))
    numbers = zip(stability.tolist(), strain.tolist(), strict=True)
    return [
        StateMinima(clear.clearance_m, *of_cell, clear.phi, clear.point_m, 0)
        if clear
        else StateMinima(-np.inf, -np.inf, np.inf, cell.cell.middle, np.full(3, np.nan), 0)
        for cell, clear, of_cell in zip(queries, _clearances(queries, distance), numbers, strict=True)
    ]


def _clearances(queries: Sequence[CellQuery], distance: Distance | None) -> list[CellClearance | None]:
    """The clearance of every cell, None where one of its states has no body."""
    results: list[CellClearance | None] = [
        CellClearance(np.inf, query.cell.middle, query.solved[-1].body_m[-1]) if query.has_bodies else None
        for query in queries
    ]
    rows = [k for k, query in enumerate(queries) if query.enough_m is not None and results[k] is not None]
    if distance and rows:
        these, bodies = [queries[k] for k in rows], _bodies([queries[k] for k in rows])
        enough = np.array([query.enough_m for query in these])
        least = np.array([query.is_least_asked for query in these])
        lengths = np.array([max(len(state.body_m) for state in query.solved) for query in these])
        clear = cell_clearances([query.cell for query in these], bodies, lengths, distance, enough, least)
        for k, clearance in zip(rows, clear, strict=True):
            results[k] = clearance
    return results


def _bodies(queries: Sequence[CellQuery]) -> Array:
    """(L, 2^P + 1, N, 4) bodies and the radii around them that they may fill, as long as the longest.

    What is too short stands at its tip for the rest, where it is already.
    """
    solved = [state for query in queries for state in query.solved]
    bodies, doubts = [state.body_m for state in solved], [state.doubt_m for state in solved]
    return cell_bodies(bodies, [query.radius_m for query in queries], doubts)


def _most(values: Array) -> Array:
    """(L,) what a number may rise to over cells by those of corners and middle (L, 2^P + 1); inf if one is unknown."""
    corners, middle = values[:, :-1], values[:, -1]
    with np.errstate(invalid="ignore"):
        most = values.max(axis=1) + ERROR_FACTOR * np.abs(middle - corners.mean(axis=1))
    return np.where(np.isfinite(most), most, np.inf)


DEPTH = 3  # halvings: 9 states along every pair
LEAST_DEPTH = 1  # the middle of the cube alone is where errors may vanish by symmetry, beside a fold
NUMBERS_DEPTH = 6  # where only stability or strain ask for them: near a fold both bend sharply
LESS_M = 0.1e-3  # than the least clearance found is asked for, until it is kept
MOST_HALVED = 2  # axes at once where a cube has others than friction's, a budget
MOST_TUBES = 6  # whose cube, halved once, has 275 corners and middles; of seven 793

Solve = Callable[[Sequence[State]], Sequence[Solved]]


def refuse_many_tubes(robot: Robot) -> None:
    """Raises InputError for a robot with more friction states than can be looked at."""
    if robot.n > MOST_TUBES:
        rule = f"has {robot.n} tubes: certificates look at every friction state of at most {MOST_TUBES}"
        raise InputError(rule, file=robot.path, key="tube")


@dataclass(frozen=True, eq=False)
class CubeQuery:
    """Whether every state of a configuration keeps what is needed."""

    known: dict[State, Solved]  # phi = 0 and every sign corner
    radius_m: Array  # (N,) outer radii
    solve: Solve
    needed: Needed
    depth: int = DEPTH  # how often cells are halved at most
    least_depth: int = LEAST_DEPTH  # and all of them at least
    is_attempt: bool = False  # ends at the first cells that will not keep what is needed
    floor_m: float = np.inf  # where less clearance than needed is left: how little of it is still asked for
    pairs: int | None = None  # first axes of the cube that are friction's; None: all of them


def cube_minima(query: CubeQuery, distance: Distance | None) -> StateMinima:
    """The minima of one configuration, as `minima_of_cubes` has them of many."""
    return minima_of_cubes([query], distance)[0]


def minima_of_cubes(queries: Sequence[CubeQuery], distance: Distance | None) -> list[StateMinima]:
    """What is known of every state of each configuration once its cells were halved until they keep what is needed.

    Where they do not keep the clearance that is needed, what they have was found at some state, and another one may
    have less. Less is asked for then, until no state has less than that, or less than the floor was found. Bodies are
    looked at where they come near enough to the anatomy to matter, not at all without a `distance`.
    """
    cubes = [_Cube(query) for query in queries]
    while open_ := [cube for cube in cubes if cube.cells]:
        cells = [cell for cube in open_ for cell in cube.cells_asked()]
        result = iter(cell_minima(cells, distance))
        for cube in open_:
            cube.go_on([next(result) for _ in cube.cells])
    return [cube.least for cube in cubes]


def _folded(minima: StateMinima) -> StateMinima:
    """A cell with a fold in it is refused for that, and nothing is said of shapes beside it."""
    return replace(minima, clearance_m=np.inf, stability=min(minima.stability, 0.0))


@dataclass(eq=False)
class _Cube:
    """The states of one configuration, and the cells of it that have to be looked at next, all of one depth."""

    query: CubeQuery
    least: StateMinima = field(init=False)
    cells: list[Cell] = field(init=False)

    def __post_init__(self) -> None:
        self.solved, self.needed = dict(self.query.known), self.query.needed
        self._solves = 0
        self._begin()

    def _begin(self) -> None:
        pairs = len(next(iter(self.solved)))
        self.least = StateMinima(np.inf, np.inf, -np.inf, (0.0,) * pairs, np.zeros(3), self._solves)
        self.cells = [Cell((-1.0,) * pairs, (1.0,) * pairs, 0)]

    def cells_asked(self) -> list[CellQuery]:
        """The cells with their states, solved if they were not known."""
        states = [[*cell.corners, cell.middle] for cell in self.cells]
        wanted = list(dict.fromkeys(state for of_cell in states for state in of_cell if state not in self.solved))
        if wanted:
            self.solved.update(zip(wanted, self.query.solve(wanted), strict=True))
            self._solves += len(wanted)
        is_looked_at = self.cells[0].depth >= self.query.least_depth  # else it is halved anyway
        return [
            CellQuery(
                cell,
                [self.solved[state] for state in of_cell],
                self.query.radius_m,
                self.needed.clearance_m if is_looked_at else None,
                is_least_asked=np.isfinite(self.query.floor_m) and not self._is_halved(cell, is_short=True),
            )
            for cell, of_cell in zip(self.cells, states, strict=True)
        ]

    def go_on(self, results: Sequence[StateMinima]) -> None:
        """Halves the cells that do not keep what is needed, and takes over what is known of the others."""
        halved = list[Cell]()
        for cell, of_cell in zip(self.cells, results, strict=True):
            is_open = cell.depth < self.query.least_depth or not of_cell.keeps(self.needed)
            is_short = of_cell.clearance_m < self.needed.clearance_m
            if is_open and self._is_halved(cell, is_short=is_short) and np.isfinite(of_cell.stability):
                halved += cell.halves(self._axes(cell))
            else:
                is_fold = is_short and not self.query.is_attempt and self._leaps(cell)
                self.least = self.least.with_less_of(_folded(of_cell) if is_fold else of_cell)
        self.cells = [] if self.query.is_attempt and not self.least.keeps(self.needed) else halved
        if not self.cells:
            self._ask_for_less()

    def _leaps(self, cell: Cell) -> bool:
        """Whether the body leaps in the cell: of the way between the opposite corners whose tips are farthest apart,
        one half always has more than half of what these are apart, however short it becomes.

        A fold is there, and a shape interpolated across it is none. Where one is known already, one step tells enough.
        """
        ends = [(corner, tuple((np.add(cell.low, cell.high) - corner).tolist())) for corner in cell.corners]
        pair = max(ends, key=lambda of: self._apart_m(*of))
        whole_m = self._apart_m(*pair)
        for _ in range(1 if self.least.stability <= 0 else NUMBERS_DEPTH):
            middle = tuple(np.mean(pair, axis=0).tolist())
            if middle not in self.solved:
                self.solved[middle] = self.query.solve([middle])[0]
            pair = max(((pair[0], middle), (middle, pair[1])), key=lambda of: self._apart_m(*of))
            if not self._apart_m(*pair) > whole_m / 2:
                return False
        return True

    def _apart_m(self, a: State, b: State) -> float:
        """Between tips of two solved states [m]."""
        return float(np.linalg.norm(self.solved[a].body_m[-1] - self.solved[b].body_m[-1]))

    def _axes(self, cell: Cell) -> Collection[int] | None:
        """Along which a cell is halved: all that are friction's, then those along which bodies lie farthest apart."""
        dimensions, pairs = len(cell.low), self.query.pairs
        if pairs is None or pairs == dimensions or dimensions <= MOST_HALVED:
            return None
        if cell.depth == 0 and pairs:
            return range(pairs)
        bodies = np.array([self.solved[state].body_m for state in cell.corners])
        cube = bodies.reshape(*[2] * dimensions, -1)
        extent = [float(np.abs(np.diff(cube, axis=axis)).mean()) for axis in range(dimensions)]
        return set(np.argsort(extent)[-MOST_HALVED:].tolist())

    def _is_halved(self, cell: Cell, *, is_short: bool) -> bool:
        """Whether a cell that does not keep what is needed, of clearance if it is short, may be halved."""
        return cell.depth < (max(self.query.depth, self.query.least_depth) if is_short else NUMBERS_DEPTH)

    def _ask_for_less(self) -> None:
        """Begins again where some state has less than is needed, so that no other has less than what is said."""
        self.least = replace(self.least, solves=self._solves)
        result, floor = self.least.clearance_m, self.query.floor_m
        if floor <= result < self.needed.clearance_m:
            self.needed = replace(self.needed, clearance_m=max(floor, result - LESS_M))
            self._begin()
