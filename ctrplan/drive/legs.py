"""Collars that hold the tubes' bases, and straight legs in joint space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError


@dataclass(frozen=True, eq=False)
class Collars:
    """Base rotations theta (K, n) [rad] and base translations l (K, n) [m], outermost tube first.

    An ideal drive puts them where they are commanded.
    """

    theta: Array
    l: Array  # noqa: E741 (as in the equations)


MERGE_TOLERANCE = 1e-9  # a merged leg passes its waypoints within this fraction of its length
STILL_RAD, STILL_M = 1e-6, 1e-8  # collars of a file or a log that differ by less stand still
LEAVES = 1e-5  # rad or m by which a sample may lie beside its leg: digits that somebody rounded
SHORTEST = 1e-4  # rad or m of a leg that no sample may leave out
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


def new_legs(corners: Array, before: Array) -> Array:
    """The polyline (L, m) of a path's legs without those that begin or end the path before it, (K, m) each."""
    least = min(len(corners), len(before))
    first = int((corners[:least] == before[:least]).all(axis=1).cumprod().sum())
    last = int((corners[-least:] == before[-least:]).all(axis=1)[::-1].cumprod().sum())
    return corners[max(0, first - 1) : max(first, len(corners) - last) + 1]


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


def places_on_legs(rows: Array, waypoints: Array, file: str | None, what: str) -> Array:
    """(T,) leg number plus share of it where joints (T, m) lie on the legs through waypoints (L + 1, m).

    Raises InputError for rows that leave the legs, go back, leave a leg out, or do not go from start to end.
    """
    places, leg, share = np.empty(len(rows)), 0, 0.0
    for k, row in enumerate(rows):
        leg, share = _next_place(row, waypoints, leg, share, file, f"{what}, sample {k + 1}")
        places[k] = leg + share
    for k, end, name in ((0, 0, "start"), (len(rows) - 1, len(waypoints) - 1, "end")):
        if np.abs(rows[k] - waypoints[end]).max() > LEAVES:
            raise InputError(f"must be at the {name} of the legs", file=file, key=f"{what}, sample {k + 1}")
    return places


def _next_place(row: Array, waypoints: Array, leg: int, share: float, file: str | None, key: str) -> tuple[int, float]:
    """The first place at or after (leg, share) where the row lies on the legs."""
    for k in range(leg, len(waypoints) - 1):
        chord = waypoints[k + 1] - waypoints[k]
        length = float(np.linalg.norm(chord))
        along = float((row - waypoints[k]) @ chord) / length**2 if length > 0 else 0.0
        at = min(max(along, share if k == leg else 0.0), 1.0)
        if np.abs(row - waypoints[k] - at * chord).max() <= LEAVES:
            return k, at
        if k > leg and length > SHORTEST:
            break
    if _apart(row, waypoints) > LEAVES:
        raise InputError(f"leaves the legs by {_apart(row, waypoints):.3g} rad or m", file=file, key=key)
    raise InputError("is out of order: the legs do not pass here after the sample before", file=file, key=key)


def _apart(row: Array, waypoints: Array) -> float:
    """Distance [rad or m, the largest joint's] of a row (m,) from the legs."""
    chords = np.diff(waypoints, axis=0)
    squares = np.sum(chords**2, axis=1)
    along = np.sum((row - waypoints[:-1]) * chords, axis=1) / np.where(squares > 0, squares, 1.0)
    feet = waypoints[:-1] + np.clip(along, 0.0, 1.0)[:, None] * chords
    return float(np.abs(row - feet).max(axis=1).min())
