"""Bodies over cells of friction states, by the core: how far they lie apart, and where their points come nearest.

A cell's bodies are interpolated multilinearly between those of its corners. Other threads work meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import ctrplan._model as _model
from ctrplan.base.arrays import Array

# Points (K, 3) and what is asked for (K,) [m] -> clearance, exact where it is below that, else a lower bound of it.
Distance = Callable[[Array, Array], Array]


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
