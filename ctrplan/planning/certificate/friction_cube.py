"""The least clearance, the least stability and the largest strain over all friction states of a configuration.

A friction state is a point phi of the cube [-1, 1]^P, one number per pair of tubes. Robots are solved at corners and
middles of cells and interpolated multilinearly in between. In the middle of a cell the interpolation is compared with
the solved robot; 1.5 times that difference is taken off what the cell's corners have. Of bodies the largest difference
from the base up to a little beyond a point counts there. A cell in which less may be left than is asked for is halved
along every pair, up to DEPTH times.

The factor is an allowance and no proof: docs/certificate.md says what was tried against it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.planning.certificate.cell_clearances import ERROR_FACTOR, CellClearance, Distance, cell_clearances
from ctrplan.planning.certificate.friction_states import Cell, Solved, State
from ctrplan.robot.robot import Robot

DEPTH = 3  # halvings: 9 states along every pair
LEAST_DEPTH = 1  # the middle of the cube alone is where errors may vanish by symmetry, beside a fold
NUMBERS_DEPTH = 6  # where only stability or strain ask for them: near a fold both bend sharply
MOST_TUBES = 6  # whose cube, halved once, has 275 corners and middles; of seven 793

Solve = Callable[[Sequence[State]], Sequence[Solved]]


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
    is_attempt: bool = False,
) -> LeastOfStates:
    """Whether every state keeps what is needed, cells being halved until they do, `depth` times at most.

    All cells are halved `least_depth` times. An attempt ends at the first cells that will not keep what is needed.

    `known`: phi = 0 and every sign corner; outer radii (N,). Bodies are looked at where they come near enough to the
    anatomy to matter, not at all without a `distance`.
    """
    known, pairs = dict(known), len(next(iter(known)))
    least = LeastOfStates(np.inf, np.inf, -np.inf, (0.0,) * pairs, np.zeros(3), 0)
    cells = [Cell((-1.0,) * pairs, (1.0,) * pairs, 0)]
    while cells:
        wanted = list(dict.fromkeys(s for cell in cells for s in (*cell.corners, cell.middle) if s not in known))
        if wanted:
            known.update(zip(wanted, solve(wanted), strict=True))
            least = replace(least, solves=least.solves + len(wanted))
        halved: list[Cell] = []
        for cell, found in _found(cells, known, radius_m, distance, needed, least_depth):
            deepest = max(depth, least_depth) if found.clearance_m < needed.clearance_m else NUMBERS_DEPTH
            is_open = cell.depth < least_depth or not found.keeps(needed)
            if is_open and cell.depth < deepest and np.isfinite(found.stability):
                halved += cell.halves()
            else:
                least = least.with_less_of(found)
        if is_attempt and not least.keeps(needed):
            return least
        cells = halved
    return least


def _found(
    cells: Sequence[Cell],
    known: dict[State, Solved],
    radius_m: Array,
    distance: Distance | None,
    needed: Needed,
    least_depth: int,
) -> Iterator[tuple[Cell, LeastOfStates]]:
    """What is known of cells, all of one depth; clearance only of those that may not be halved anyway."""
    solved = [[known[state] for state in (*cell.corners, cell.middle)] for cell in cells]
    bodies = np.array([[one.with_radius(radius_m) for one in states] for states in solved])
    is_finite = np.isfinite(bodies).all(axis=(1, 2, 3))
    looked_at = np.flatnonzero(is_finite).tolist() if cells[0].depth >= least_depth else []
    clearances: dict[int, CellClearance] = {}
    if distance and looked_at:
        these = [cells[k] for k in looked_at]
        found = cell_clearances(these, bodies[looked_at, :-1], bodies[looked_at, -1], distance, needed.clearance_m)
        clearances = dict(zip(looked_at, found, strict=True))
    for k, (cell, (*corners, middle)) in enumerate(zip(cells, solved, strict=True)):
        if not is_finite[k]:
            yield cell, LeastOfStates(-np.inf, -np.inf, np.inf, cell.middle, np.full(3, np.nan), 0)
            continue
        clear = clearances.get(k, CellClearance(np.inf, cell.middle, middle.body_m[-1]))
        stability = -_most([-corner.stability for corner in corners], -middle.stability)
        strain = _most([corner.max_strain for corner in corners], middle.max_strain)
        yield cell, LeastOfStates(clear.clearance_m, stability, strain, clear.phi, clear.point_m, 0)


def _most(corners: list[float], middle: float) -> float:
    """What a number may rise to over a cell; inf where one is not known."""
    most = max(*corners, middle) + ERROR_FACTOR * abs(middle - float(np.mean(corners)))
    return most if np.isfinite(most + float(np.sum(corners))) else np.inf
