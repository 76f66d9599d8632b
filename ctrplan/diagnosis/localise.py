"""Where model and measurement disagree: a sentence, and what the residuals go along with.

Residuals of the calibrated model are compared with everything a pose comes with; a permutation of whole
configurations says how much of that is chance, corrected for the number of quantities looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.measurement.approach import friction_state
from ctrplan.measurement.measurements import Measurements

PERMUTATIONS, SEED = 200, 3
CHANCE = 0.05
BINS = 4
RESOLUTION = 1000  # parts of a quantity's range: values nearer to each other are one
TINY = 1e-300
IN_ORDER = 0.5  # likeness of neighbours' joints, from which what changes with time may as well go along with the joints
ROUNDED_RAD = 1e-9  # by which an angle may fall short of zero without coming out as a full turn
LONGEST = 3.0  # of the median norm of residuals


@dataclass(frozen=True)
class Trend:
    """How far a quantity predicts the size of the residuals or their direction."""

    quantity: str
    share: float  # of the residuals' sum of squares explained by means over its quarters, or by its neighbours
    p: float  # probability of that much by chance, for the largest of all quantities


@dataclass(frozen=True, eq=False)
class Place:
    """Where the disagreement is."""

    trends: tuple[Trend, ...]
    sentence: str
    between_share: float  # of the sum of squares that approaches of one configuration share
    rms_m: float  # of the calibrated model's errors


def quantities(data: Measurements) -> Mapping[str, Array]:
    """What each pose comes with, (K,) each."""
    rows, n = data.rows, data.n
    results: dict[str, Array] = {}
    for i in range(1, n):
        turn = data.theta_commanded[rows, i] - data.theta_commanded[rows, i - 1]
        results[f"angle of tube {i + 1} against tube {i}"] = np.mod(turn + ROUNDED_RAD, 2 * np.pi)
        results[f"direction of approach of tubes {i} and {i + 1}"] = friction_state(data)[:, i - 1]
    for i in range(n):
        results[f"translation of tube {i + 1}"] = data.l_commanded[rows, i]
        results[f"commanded rotation of tube {i + 1}"] = data.theta_commanded[rows, i]
    for k, axis in enumerate("xyz"):
        results[f"{axis} of the tip"] = data.position_m[:, k]
    if data.time_s is not None:
        results["time"] = data.time_s[rows]
    results |= {name: values[rows] for name, values in data.more.items()}
    return {name: values for name, values in results.items() if _differs(values)}


def localise(
    data: Measurements,
    r: Array,
    group: NDArray[np.int_],
    error_m: Array,
    floor_m: float,
    opening: str = "After calibration",
) -> Place:
    """From whitened residuals (K, 5) and distances (K,) of the calibrated model, or of another that `opening` names."""
    known, r = quantities(data), _bounded(r)
    joints = np.hstack([data.theta_commanded, data.l_commanded])[data.rows]
    joints = (joints - joints.mean(axis=0)) / np.maximum(joints.std(axis=0), TINY)
    own = {*data.more, "time"}  # quantities that are none of the robot's
    ways = [
        (_quarters(values), order[:0] if name in own and _likeness(joints[None, order])[0] > IN_ORDER else order)
        for name, values in known.items()
        for order in [_in_order(values)]
    ]
    rng = np.random.default_rng(SEED)
    (observed,) = _shares(r[None], ways)
    chance = _shares(_shuffles(r, group, rng), ways)
    middle, spread = chance.mean(axis=0), np.maximum(chance.std(axis=0), 1e-12)
    z = ((observed - middle) / spread).max(axis=1)
    highest = ((chance - middle) / spread).max(axis=(1, 2))
    beyond = (observed - middle).max(axis=1)
    trends = [
        Trend(name, float(share), float((1 + np.sum(highest >= value)) / (1 + PERMUTATIONS)))
        for name, share, value in zip(known, observed.max(axis=1), z, strict=True)
    ]
    order = np.argsort(-beyond)
    ranked = tuple(trends[k] for k in order)
    between = float(_share(r[None], np.unique(group, return_inverse=True)[1])[0])
    rms_m = float(np.sqrt(np.mean(error_m**2)))
    return Place(ranked, _sentence(opening, ranked, known, error_m, floor_m, between), between, rms_m)


def _sentence(
    opening: str,
    ranked: tuple[Trend, ...],
    known: Mapping[str, Array],
    error_m: Array,
    floor_m: float,
    between: float,
) -> str:
    rms = float(np.sqrt(np.mean(error_m**2)))
    start = f"{opening} tips are {rms * 1e3:.2f} mm off (rms, noise {floor_m * 1e3:.2f} mm)"
    clear = [trend for trend in ranked if trend.p < CHANCE][:2]
    if not clear:
        return f"{start}; the rest goes along with none of {len(ranked)} quantities looked at."
    parts = []
    for trend in clear:
        part = _quarters(known[trend.quantity])
        sizes = [float(np.sqrt(np.mean(error_m[part == k] ** 2))) * 1e3 for k in np.unique(part)]
        parts.append(f"the {trend.quantity} ({min(sizes):.2f} to {max(sizes):.2f} mm rms over its range)")
    kind = "is shared by all approaches of a configuration" if between > 0.5 else "differs between approaches"
    return f"{start}; the error goes along with {' and '.join(parts)} and mostly {kind}."


def _differs(values: Array) -> bool:
    """Whether a quantity (K,), blank where NaN, tells poses apart."""
    given = values[np.isfinite(values)]
    return len(given) > 0 and (len(given) < len(values) or bool(np.ptp(given) > 1e-6))


def _quarters(values: Array) -> NDArray[np.int_]:
    """(K,) quarter of its range, by rank, that each value falls into; few distinct values are their own classes.

    Blanks (NaN) are a class of their own, the last.
    """
    given = np.isfinite(values)
    low = values[given].min()
    levels = np.round((values - low) / max(np.ptp(values[given]), TINY) * RESOLUTION)  # whatever the unit
    distinct = np.unique(levels[given])
    if len(distinct) <= BINS:
        part = np.searchsorted(distinct, levels)
    else:
        edges = np.quantile(values[given], np.arange(1, BINS) / BINS)
        part = np.searchsorted(edges, values, side="right")
    return np.where(given, part, BINS)


def _in_order(values: Array) -> NDArray[np.intp]:
    """(G,) poses that have a value, the smallest first; none where it has few distinct ones."""
    given = np.flatnonzero(np.isfinite(values))
    few = len(np.unique(_quarters(values)[given])) < BINS or len(np.unique(values[given])) <= BINS
    return given[:0] if few else given[np.argsort(values[given], kind="stable")]


def _shares(r: Array, ways: Sequence[tuple[NDArray[np.int_], NDArray[np.intp]]]) -> Array:
    """(D, Q, 2) of the sum of squares, what means over quarters of each quantity explain, and what neighbours do.

    r (D, K, 5): residuals in D orders. Neighbours in the order of a quantity are alike where errors depend on it
    smoothly, in whatever way: up and down again as well, which leaves the means of quarters alike.
    """
    return np.stack([np.stack([_share(r, part), _likeness(r[:, order])], axis=1) for part, order in ways], axis=1)


def _likeness(r: Array) -> Array:
    """(D,) correlations of neighbours (D, G, 5), by von Neumann's ratio."""
    if r.shape[1] < 2:
        return np.zeros(len(r))
    apart, square = (np.diff(r, axis=1) ** 2).sum(axis=(1, 2)), (r**2).sum(axis=(1, 2))
    alike: Array = 1 - apart / np.maximum(2 * square, 1e-12)
    return alike


def _share(r: Array, part: NDArray[np.int_]) -> Array:
    """(D,) shares of the sum of squares of residuals (D, K, 5) that means over classes (K,) explain."""
    members = part == np.arange(part.max() + 1)[:, None]
    sums = members.astype(float) @ r
    explained = (sums**2 / np.maximum(members.sum(axis=1), 1)[:, None]).sum(axis=(1, 2))
    share: Array = explained / np.maximum((r**2).sum(axis=(1, 2)), 1e-12)
    return share


def _bounded(r: Array) -> Array:
    """Residuals (K, 5) none of which is much longer than most: a few wild poses are no trend."""
    norm = np.linalg.norm(r, axis=1)
    longest = LONGEST * np.median(norm)
    bounded: Array = r * np.minimum(1.0, longest / np.maximum(norm, 1e-12))[:, None]
    return bounded


def _shuffles(r: Array, group: NDArray[np.int_], rng: np.random.Generator) -> Array:
    """Residuals (PERMUTATIONS, K, 5) with whole configurations exchanged and approaches exchanged inside them."""
    numbers = [np.flatnonzero(group == number) for number in np.unique(group)]
    places, shuffled = np.concatenate(numbers), np.empty((PERMUTATIONS, *r.shape))
    for moved in shuffled:
        moved[places] = r[np.concatenate([rng.permutation(numbers[k]) for k in rng.permutation(len(numbers))])]
    return shuffled
