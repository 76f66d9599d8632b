"""Bodies over cells of friction states, by the core: how far they lie apart, and where their points come nearest.

A cell's bodies are interpolated multilinearly between those of its corners. Other threads work meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan import _model
from ctrplan.base.arrays import Array

# Points (K, 3) and what is asked for (K,) [m] -> clearance, exact where it is below that, else a lower bound of it.
Distance = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Doubts:
    """What is said of bodies that were not solved themselves, as shares of what is known beside them."""

    change: float  # of the difference between the bends on both sides
    bend: float  # of the bend
    spread: float  # of the largest distance of a sign corner from the frictionless body
    beyond: int  # points towards the tip whose doubt counts too


def bodies_between(
    shapes_m: Array, phi: Array, first: tuple[Array, Array], last: tuple[Array, Array], share: float, doubts: Doubts
) -> tuple[Array, Array]:
    """(S, M, 3) bodies [m] in states phi (S, P) of a configuration between two others, and (S, M) what they may be off.

    shapes_m (1 + 2^P, M, 3): solved without friction and in the sign corners. A body lies off the multilinear
    interpolation of the corners by its bend; `first` and `last` have shares of the length (N,) of the configurations
    on both sides, and their bends (S, N, 3); `share` is that of the way from the first to the last.
    """
    shares = (doubts.change, doubts.bend, doubts.spread)
    bodies, doubt = _model.bodies_between(shapes_m, phi, *first, *last, share, shares, doubts.beyond)
    return np.asarray(bodies), np.asarray(doubt)


def cell_bodies(bodies_m: Sequence[Array], radius_m: Sequence[Array], doubt_m: Sequence[Array | None]) -> Array:
    """(L, 2^P + 1, N, 4) [m] bodies of L cells and the radii around them that they may fill, as long as the longest.

    Of corners and middle, cell by cell: points (K, 3), and what they may be off by (K,), if anything; radii (K,) of a
    cell. What is too short stands at its tip for the rest, where it is already.
    """
    of_cell = len(bodies_m) // len(radius_m)
    return np.asarray(_model.cell_bodies(list(bodies_m), list(radius_m), list(doubt_m), of_cell))


def cell_spread(bodies_m: Array, beyond: int) -> tuple[Array, Array]:
    """(L, N), (L, N) [m] of L cells with bodies (L, 2^P + 1, N, 4), of corners and middle: points and radii.

    First the largest distance of the middle's body from the mean of the corners', from the base up to `beyond` points
    further out: what interpolation is off by there. Then how far a corner's surface lies at most from the middle's
    centreline, the middle's radius taken off.
    """
    off, reach = _model.cell_spread(bodies_m, beyond)
    return np.asarray(off), np.asarray(reach)


def least_of_points(
    bodies_m: Array,
    points: NDArray[np.intp],
    error_m: Array,
    enough_m: Array,
    distance: Distance,
    *,
    parts: int,
    half_m: float,
    halvings: int,
) -> tuple[Array, Array, Array]:
    """(S,) lower bounds of clearance over all states of a cell, (S, P) states there, 0 to 1 of the cell, (S, 3) where.

    Of `parts` of the body around each of K points of cells' bodies (L, 2^P + 1, N, 4), counted over all cells: S is
    parts K, part by part. Each stands for `half_m` of the body on both sides. error_m (L, N) is taken off, enough_m
    (L,) is what is asked for: less than that says only that it is not enough. States are halved up to `halvings` times
    along every pair, where they move the point most.
    """
    search = _model.PointsInCells(bodies_m, points, error_m, enough_m, parts, half_m, halvings)
    while len(asked := np.asarray(search.points())):
        search.tell(np.ascontiguousarray(distance(asked, np.asarray(search.needed()))))
    least, unit, place = search.found()
    return np.asarray(least), np.asarray(unit), np.asarray(place)
