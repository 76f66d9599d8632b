"""Collars that hold the tubes' bases, and straight legs in joint space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Collars:
    """Base rotations theta (K, n) [rad] and base translations l (K, n) [m], outermost tube first.

    An ideal drive puts them where they are commanded.
    """

    theta: Array
    l: Array  # noqa: E741 (as in the equations)


MERGE_TOLERANCE = 1e-9  # a merged leg passes its waypoints within this fraction of its length
STILL_RAD, STILL_M = 1e-6, 1e-8  # collars of a file or a log that differ by less stand still
LINE_TOLERANCE = 1e-12  # rad or m off its leg, or beside the waypoint that it repeats, that counts as none


def merge_legs(waypoints: Array) -> Array:
    """Corners (L + 1, m) of the path through waypoints (K, m) [rad, m], K >= 1: no repeats, no collinear inner points.

    A waypoint is dropped where the path goes on in the same direction and all waypoints dropped since the last corner
    stay within MERGE_TOLERANCE of the merged leg's length (plus rounding) of that leg: a finely sampled curve is not
    straightened little by little. A reversal is a corner. Distances count 1 rad as 1 m.
    """
    points = _without_repeats(waypoints)
    corners, bow = [0], 0.0
    for k in range(1, len(points) - 1):
        bow = _bow(points[corners[-1] : k + 2], bow)
        if math.isinf(bow):
            corners.append(k)
            bow = 0.0
    if len(points) > 1:
        corners.append(len(points) - 1)
    return points[corners]


def distance_from_leg(points: Array, start: Array, end: Array) -> Array:
    """Distances (K,) of points (K, m) from the straight segments start - end, each (m,) or (K, m), 1 rad as 1 m."""
    chord = end - start
    along = np.sum((points - start) * chord, axis=-1) / np.sum(chord * chord, axis=-1)
    offset = points - start - np.clip(along, 0.0, 1.0)[..., None] * chord
    distance: Array = np.linalg.norm(offset, axis=-1)
    return distance


def distance_from_polyline(points: Array, corners: Array) -> Array:
    """Distances (K,) of points (K, d) from the polyline through corners (L, d), L >= 2, some of them equal."""
    nearest = np.full(len(points), np.inf)
    for start, end in zip(corners[:-1], corners[1:], strict=True):
        leg = (
            np.linalg.norm(points - start, axis=1)
            if np.array_equal(start, end)
            else distance_from_leg(points, start, end)
        )
        nearest = np.minimum(nearest, leg)
    return nearest


def rounding(points: Array) -> float:
    """What rounding may do to a distance between points of this magnitude."""
    return float(8 * np.finfo(np.float64).eps * np.abs(points).max())


def _without_repeats(waypoints: Array) -> Array:
    same = LINE_TOLERANCE + rounding(waypoints)
    kept = [0]
    for k in range(1, len(waypoints)):
        if np.abs(waypoints[k] - waypoints[kept[-1]]).max() > same:
            kept.append(k)
    return waypoints[kept]


def _bow(run: Array, bow: float) -> float:
    """Bound on the distance of run's inner points from its chord, given that bound for run[:-1]; inf: not one leg."""
    start, via, end = run[0], run[-2], run[-1]
    if (via - start) @ (end - via) <= 0:
        return math.inf
    allowed = MERGE_TOLERANCE * float(np.linalg.norm(end - start)) + rounding(run[[0, -1]])
    # Replacing the chord start-via by start-end moves no point of it by more than via's distance: cheap, and usually
    # enough; measured anew where the sum has grown too large, so that long runs stay linear in time.
    bow += float(distance_from_leg(via, start, end))
    if bow > allowed:
        bow = float(distance_from_leg(run[1:-1], start, end).max())
    return bow if bow <= allowed else math.inf
