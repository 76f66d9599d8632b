"""What the states of a cell keep, by those of its corners and its middle.

In the middle of a cell the multilinear interpolation of its corners is compared with the solved robot; ERROR_FACTOR
times that difference is taken off what the corners have. The factor is an allowance and no proof: docs/certificate.md
says what was tried against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.friction_cells import Distance, cell_bodies
from ctrplan.planning.certificate.cell_clearances import ERROR_FACTOR, CellClearance, cell_clearances
from ctrplan.planning.certificate.friction_states import Cell, Solved
from ctrplan.planning.certificate.least_of_states import LeastOfStates


@dataclass(frozen=True, eq=False)
class CellAsked:
    """A cell with its robots."""

    cell: Cell
    solved: Sequence[Solved]  # of its 2^P corners, then of its middle
    radius_m: Array  # (N,) outer radii
    enough_m: float | None  # clearance that is asked for; None if none is
    is_least_asked: bool = True  # also where it is not enough

    @property
    def has_bodies(self) -> bool:
        """Whether all of its states have an equilibrium."""
        return all(one.has_body for one in self.solved)


def least_of_cells(asked: Sequence[CellAsked], distance: Distance | None) -> list[LeastOfStates]:
    """Of L cells; clearance is inf where it was not asked for, or without a `distance`."""
    stability = -_most(np.array([[-one.stability for one in cell.solved] for cell in asked]))
    strain = _most(np.array([[one.max_strain for one in cell.solved] for cell in asked]))
    numbers = zip(stability.tolist(), strain.tolist(), strict=True)
    return [
        LeastOfStates(clear.clearance_m, *of_cell, clear.phi, clear.point_m, 0)
        if clear
        else LeastOfStates(-np.inf, -np.inf, np.inf, cell.cell.middle, np.full(3, np.nan), 0)
        for cell, clear, of_cell in zip(asked, _clearances(asked, distance), numbers, strict=True)
    ]


def _clearances(asked: Sequence[CellAsked], distance: Distance | None) -> list[CellClearance | None]:
    """Of every cell, None where one of its states has no body."""
    found: list[CellClearance | None] = [
        CellClearance(np.inf, one.cell.middle, one.solved[-1].body_m[-1]) if one.has_bodies else None for one in asked
    ]
    rows = [k for k, one in enumerate(asked) if one.enough_m is not None and found[k] is not None]
    if distance and rows:
        these, bodies = [asked[k] for k in rows], _bodies([asked[k] for k in rows])
        enough = np.array([one.enough_m for one in these])
        least = np.array([one.is_least_asked for one in these])
        clear = cell_clearances([one.cell for one in these], bodies, distance, enough, least)
        for k, clearance in zip(rows, clear, strict=True):
            found[k] = clearance
    return found


def _bodies(asked: Sequence[CellAsked]) -> Array:
    """(L, 2^P + 1, N, 4) bodies and the radii around them that they may fill, as long as the longest.

    What is too short stands at its tip for the rest, where it is already.
    """
    solved = [state for one in asked for state in one.solved]
    bodies, doubts = [state.body_m for state in solved], [state.doubt_m for state in solved]
    return cell_bodies(bodies, [one.radius_m for one in asked], doubts)


def _most(values: Array) -> Array:
    """(L,) what a number may rise to over cells by those of corners and middle (L, 2^P + 1); inf if one is unknown."""
    corners, middle = values[:, :-1], values[:, -1]
    with np.errstate(invalid="ignore"):
        most = values.max(axis=1) + ERROR_FACTOR * np.abs(middle - corners.mean(axis=1))
    return np.where(np.isfinite(most), most, np.inf)
