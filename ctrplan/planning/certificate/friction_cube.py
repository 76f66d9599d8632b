"""The least clearance, the least stability and the largest strain over all friction states of a configuration.

A friction state is a point phi of the cube [-1, 1]^P, one number per pair of tubes. Robots are solved at corners and
middles of cells and interpolated multilinearly in between (`cell_bounds.py`). A cell in which less may be left than is
asked for is halved along every pair, up to DEPTH times. Many configurations are looked at at once: there is little to
compute of each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.friction_cells import Distance
from ctrplan.planning.certificate.cell_bounds import CellAsked, least_of_cells
from ctrplan.planning.certificate.friction_states import Cell, Solved, State
from ctrplan.planning.certificate.least_of_states import LeastOfStates, Needed
from ctrplan.robot.robot import Robot

DEPTH = 3  # halvings: 9 states along every pair
LEAST_DEPTH = 1  # the middle of the cube alone is where errors may vanish by symmetry, beside a fold
NUMBERS_DEPTH = 6  # where only stability or strain ask for them: near a fold both bend sharply
LESS_M = 0.1e-3  # than the least clearance found is asked for, until it is kept
MOST_TUBES = 6  # whose cube, halved once, has 275 corners and middles; of seven 793

Solve = Callable[[Sequence[State]], Sequence[Solved]]


def refuse_many_tubes(robot: Robot) -> None:
    """Raises InputError for a robot with more friction states than can be looked at."""
    if robot.n > MOST_TUBES:
        rule = f"has {robot.n} tubes: certificates look at every friction state of at most {MOST_TUBES}"
        raise InputError(rule, file=robot.path, key="tube")


@dataclass(frozen=True, eq=False)
class CubeAsked:
    """Whether every state of a configuration keeps what is needed."""

    known: dict[State, Solved]  # phi = 0 and every sign corner
    radius_m: Array  # (N,) outer radii
    solve: Solve
    needed: Needed
    depth: int = DEPTH  # how often cells are halved at most
    least_depth: int = LEAST_DEPTH  # and all of them at least
    is_attempt: bool = False  # ends at the first cells that will not keep what is needed
    floor_m: float = np.inf  # where less clearance than needed is left: how little of it is still asked for


def least_of_cube(asked: CubeAsked, distance: Distance | None) -> LeastOfStates:
    """Of one configuration; see `least_of_cubes`."""
    return least_of_cubes([asked], distance)[0]


def least_of_cubes(asked: Sequence[CubeAsked], distance: Distance | None) -> list[LeastOfStates]:
    """What is known of every state of each configuration once its cells were halved until they keep what is needed.

    Where they do not keep the clearance that is needed, what they have was found at some state, and another one may
    have less. Less is asked for then, until no state has less than that, or less than the floor was found. Bodies are
    looked at where they come near enough to the anatomy to matter, not at all without a `distance`.
    """
    cubes = [_Cube(one) for one in asked]
    while open_ := [cube for cube in cubes if cube.cells]:
        cells = [cell for cube in open_ for cell in cube.cells_asked()]
        found = iter(least_of_cells(cells, distance))
        for cube in open_:
            cube.go_on([next(found) for _ in cube.cells])
    return [cube.least for cube in cubes]


@dataclass(eq=False)
class _Cube:
    """The states of one configuration, and the cells of it that have to be looked at next, all of one depth."""

    asked: CubeAsked
    least: LeastOfStates = field(init=False)
    cells: list[Cell] = field(init=False)

    def __post_init__(self) -> None:
        self.solved, self.needed = dict(self.asked.known), self.asked.needed
        self._solves = 0
        self._begin()

    def _begin(self) -> None:
        pairs = len(next(iter(self.solved)))
        self.least = LeastOfStates(np.inf, np.inf, -np.inf, (0.0,) * pairs, np.zeros(3), self._solves)
        self.cells = [Cell((-1.0,) * pairs, (1.0,) * pairs, 0)]

    def cells_asked(self) -> list[CellAsked]:
        """The cells with their states, solved if they were not known."""
        states = [[*cell.corners, cell.middle] for cell in self.cells]
        wanted = list(dict.fromkeys(state for of_cell in states for state in of_cell if state not in self.solved))
        if wanted:
            self.solved.update(zip(wanted, self.asked.solve(wanted), strict=True))
            self._solves += len(wanted)
        is_looked_at = self.cells[0].depth >= self.asked.least_depth  # else it is halved anyway
        return [
            CellAsked(
                cell,
                [self.solved[state] for state in of_cell],
                self.asked.radius_m,
                self.needed.clearance_m if is_looked_at else None,
                is_least_asked=np.isfinite(self.asked.floor_m) and not self._is_halved(cell, is_short=True),
            )
            for cell, of_cell in zip(self.cells, states, strict=True)
        ]

    def go_on(self, found: Sequence[LeastOfStates]) -> None:
        """Halves the cells that do not keep what is needed, and takes over what is known of the others."""
        halved = list[Cell]()
        for cell, of_cell in zip(self.cells, found, strict=True):
            is_open = cell.depth < self.asked.least_depth or not of_cell.keeps(self.needed)
            is_short = of_cell.clearance_m < self.needed.clearance_m
            if is_open and self._is_halved(cell, is_short=is_short) and np.isfinite(of_cell.stability):
                halved += cell.halves()
            else:
                self.least = self.least.with_less_of(of_cell)
        self.cells = [] if self.asked.is_attempt and not self.least.keeps(self.needed) else halved
        if not self.cells:
            self._ask_for_less()

    def _is_halved(self, cell: Cell, *, is_short: bool) -> bool:
        """Whether a cell that does not keep what is needed, of clearance if it is short, may be halved."""
        return cell.depth < (max(self.asked.depth, self.asked.least_depth) if is_short else NUMBERS_DEPTH)

    def _ask_for_less(self) -> None:
        """Begins again where some state has less than is needed, so that no other has less than what is said."""
        self.least = replace(self.least, solves=self._solves)
        found, floor = self.least.clearance_m, self.asked.floor_m
        if floor <= found < self.needed.clearance_m:
            self.needed = replace(self.needed, clearance_m=max(floor, found - LESS_M))
            self._begin()
