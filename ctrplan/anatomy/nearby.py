"""Which of many parts can matter around a place: where there are thousands, all others are not asked for distances."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.parts import AnatomyPart, exact_clearance, surface_distance
from ctrplan.base.arrays import Array

FEW = 8  # parts that are asked straight away
MANY = 64  # parts of which boxes are looked at first, where places are few: boxes of many take longer than they save
ROUNDING_M = 1e-9
CELL_M = 10e-3  # within which points are asked together


def nearby(parts: Sequence[AnatomyPart], places_m: Array, radius_m: float) -> list[tuple[AnatomyPart, ...]]:
    """For each of C places (C, 3) [m] the parts that may decide the clearance of any point within `radius_m` of it.

    Distances change by no more than a point moves, so that a part stays behind the nearest one wherever it is behind
    by twice the radius. Lumens are one room: of them those count that a point may be deepest in.
    """
    matters = np.ones((len(parts), len(places_m)), dtype=bool)
    for role, sign in (("avoid", 1.0), ("inside", -1.0)):
        rows = [k for k, part in enumerate(parts) if part.role == role]
        if not rows:
            continue
        if sign > 0 and len(rows) > MANY and len(places_m) <= FEW:
            matters[rows] = False
            rows = [rows[k] for k in np.flatnonzero(_within_reach([parts[k] for k in rows], places_m, radius_m))]
        margin = np.array([[parts[k].margin_m] for k in rows])
        clearance = sign * np.array([surface_distance(parts[k], places_m) for k in rows]) - margin
        behind = clearance - clearance.min(axis=0) if sign > 0 else clearance.max(axis=0) - clearance
        matters[rows] = behind <= 2 * radius_m
    return [tuple(parts[k] for k in np.flatnonzero(column).tolist()) for column in matters.T]


def _within_reach(parts: Sequence[AnatomyPart], places_m: Array, radius_m: float) -> NDArray[np.bool_]:
    """(K,) which parts to avoid may matter around any of the places (C, 3) [m], by boxes alone: none is asked.

    A surface is nowhere nearer than its box, seen from outside, and nowhere farther than the box's farthest corner.
    """
    lower, upper = (np.array([part.box[end] for part in parts])[:, None] for end in (0, 1))
    margin = np.array([part.margin_m for part in parts])
    outside = np.maximum(np.maximum(lower - places_m, places_m - upper), 0.0)
    nearest = np.linalg.norm(outside, axis=2)
    nearest[nearest == 0] = -np.inf  # within the box, maybe deep in the part
    farthest = np.linalg.norm(np.maximum(np.abs(places_m - lower), np.abs(places_m - upper)), axis=2)
    least = (farthest - margin[:, None]).min(axis=0)
    reach: NDArray[np.bool_] = (nearest - margin[:, None] <= least + 2 * radius_m + ROUNDING_M).any(axis=1)
    return reach


def exact_clearance_of_many(parts: Sequence[AnatomyPart], points_m: Array) -> Array:
    """As `parts.exact_clearance`, of many parts and points cell by cell: the same digits in a fraction of the time."""
    points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
    if len(parts) <= FEW or not len(points) or not np.isfinite(points).all():
        return exact_clearance(parts, points)
    clearance = np.empty(len(points))
    for rows, few in _cells(parts, points):
        clearance[rows] = exact_clearance(few, points[rows])
    return clearance


def _cells(parts: Sequence[AnatomyPart], points: Array) -> Iterator[tuple[NDArray[np.intp], tuple[AnatomyPart, ...]]]:
    """Rows of the points in each cell, and the parts that may matter there."""
    cells, owner = np.unique(np.floor(points / CELL_M), axis=0, return_inverse=True)
    order = np.argsort(owner.ravel(), kind="stable")
    rows = np.split(order, np.cumsum(np.bincount(owner.ravel()))[:-1])
    radius = CELL_M * np.sqrt(3) / 2 * (1 + 1e-9)
    yield from zip(rows, nearby(parts, (cells + 0.5) * CELL_M, float(radius)), strict=True)
