"""The gap on the test set before and after effects were added, and the rule that no verdict is greener than its
figures.

Where model and measurement disagree: a sentence, and what the residuals go along with.

Residuals of the calibrated model are compared with everything a pose comes with; a permutation of whole
configurations says how much of that is chance, corrected for the number of quantities looked at.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import Errors, distances, summary
from ctrplan.calibration.fit_warnings import excused
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import MODEL_POSITION_M, Noise, Residuals, residuals
from ctrplan.diagnosis.adequacy import HEAVY, ChiSquare, outliers, tail_weight
from ctrplan.diagnosis.verdict import Verdict
from ctrplan.measurement.approach import friction_state
from ctrplan.measurement.measurements import SEED, Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import SensorPrediction


@dataclass(frozen=True, eq=False)
class Gap:
    """Before: calibrated, without the effects; after: with them. Regions are named in words."""

    nominal: Errors
    before: Errors
    after: Errors
    floor_m: float
    tails: float  # of the residuals that were fitted: variance of their squares over what it is for Gaussian noise
    spread_m: float  # rms distance that the uncertainty of the fitted parameters leaves open, with the effects
    regions: Mapping[str, tuple[Errors, Errors]]
    before_m: Array  # (V,) distances of the held-out set's poses, without those that are left out
    after_m: Array
    chi_square: ChiSquare  # of the held-out set's poses under the predictive distribution of the fit with the effects
    failed: NDArray[np.bool_]  # of all poses of the held-out set: without a solution, before or after
    outlying: NDArray[np.bool_]  # likewise: too far off for noise while few are, left out of every figure


def open_test_set(before: Fit, after: Fit, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise) -> Gap:
    """Predicts the held-out set's poses with fits that have not seen them; where one has no solution, none is asked.

    Few poses too far off for noise are in no figure: what chi-squares leave out, errors leave out as well.
    """
    chains = [ParametricChain(f.chain.robot, held_out_set, f.chain.terms) for f in (before, before, after)]
    values = (before.chain.neutral, before.p, after.p)
    for chain, p in zip(chains[1:], values[1:], strict=True):
        chain.correction = friction_correction(chain, p)
    predictions = [chain.predict(p, derivatives=False) for chain, p in zip(chains, values, strict=True)]
    failed = predictions[1].failed | predictions[2].failed
    kept = ~excused(failed)
    effective_there = chains[2].predict(after.p)
    result = _residuals(effective_there.subset(kept), held_out_set.subset(kept), group[kept], noise)
    outlying, near = np.zeros(len(kept), bool), ~outliers(result.raw_norm)
    outlying[np.flatnonzero(kept)[~near]] = True
    kept &= ~outlying
    held_out_set, group = held_out_set.subset(kept), group[kept]
    errors = [distances(prediction.subset(kept), held_out_set) for prediction in predictions]
    regions = {
        name: (summary(errors[1][inside], group[inside]), summary(errors[2][inside], group[inside]))
        for name, inside in _regions(held_out_set).items()
    }
    nominal, calibrated, effective = (summary(e, group) for e in errors)
    chi_square = _predictive(result.r[near][result.given[near]], result.J[near][result.given[near]], after)
    return Gap(
        nominal,
        calibrated,
        effective,
        noise.floor_m,
        _tails(after.residuals),
        _spread_m(effective_there.subset(kept).position_by, after),
        regions,
        errors[1],
        errors[2],
        chi_square,
        failed,
        outlying,
    )


def _tails(fitted: Residuals) -> float:
    near = ~outliers(fitted.raw_norm)
    weight = tail_weight(fitted.norm[near], fitted.given.sum(axis=1)[near]) if near.any() else 1.0
    return weight if weight > HEAVY else 1.0


def _spread_m(position_by: Array, after: Fit) -> float:
    """Rms distance, of positions with derivatives (V, 3, P), within the covariance of the parameters."""
    per_pose = np.einsum("kip,pq,kiq->k", position_by, after.covariance, position_by)
    return float(np.sqrt(per_pose.mean())) if len(per_pose) else 0.0


def _regions(held_out_set: Measurements) -> dict[str, NDArray[np.bool_]]:
    """Thirds by extension of the innermost tube, or by time where it does not slide."""
    out = held_out_set.l_commanded[held_out_set.rows, -1]
    if np.ptp(out) < 1e-3:
        out, words = held_out_set.rows.astype(float), ("first third", "second third", "last third")
    else:
        words = ("innermost tube retracted", "innermost tube half way", "innermost tube extended")
    edges = np.quantile(out, [1 / 3, 2 / 3])
    third = np.searchsorted(edges, out, side="right")
    return {word: third == k for k, word in enumerate(words) if np.any(third == k)}


def _residuals(
    prediction: SensorPrediction, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise
) -> Residuals:
    whitening: Sequence[int] | NDArray[np.int_] = np.arange(len(group)) if held_out_set.is_stream else group
    return residuals(held_out_set, prediction, noise, whitening)


def _predictive(r: Array, J: Array, after: Fit) -> ChiSquare:
    """Residuals (R,) with derivatives (R, P) over noise and the parameters' own uncertainty together."""
    spread = np.eye(len(r)) + J @ after.covariance @ J.T
    return ChiSquare(float(r @ np.linalg.solve(spread, r)), len(r))


LARGEST_REST = 1.5  # of the noise: rms error with which a model still agrees with measurements
LEAST_TOLD = 0.2  # of the noise: what parameters leave open


def times_noise(rms_m: float, floor_m: float) -> float:
    """An rms error [m] over the noise and the solver's own error."""
    return rms_m / math.hypot(floor_m, math.sqrt(3) * MODEL_POSITION_M)


def largest_remainder(tails: float) -> float:
    """The largest remainder that noise leaves, whose squares vary `tails` times as much as Gaussian ones: so much
    less certain is their mean.
    """
    return math.sqrt(1 + (LARGEST_REST**2 - 1) * math.sqrt(tails))


def contradiction(verdict: Verdict, gap: Gap, place: Place) -> str:
    """What contradicts a verdict that says that a model agrees with the measurements, as a sentence; empty if nothing.

    On the poses kept aside it is the error with the effects, beyond noise and what the fitted parameters leave open:
    few poses do not settle an effect of many parameters, and noise with heavy tails is larger here and smaller there.
    Where none is missing, no tails are allowed for, and the poses that were fitted are asked as well.
    """
    if verdict == "partial" and gap.after.rms_m >= gap.before.rms_m:
        off = f"{gap.before.rms_m * 1e3:.2f} mm off (rms) without them and {gap.after.rms_m * 1e3:.2f} mm with them"
        return f"The figures contradict the effects found: on the poses kept aside tips are {off}."
    if verdict in ("partial", "unexplained"):
        return ""
    is_complete = verdict == "no_missing_effect"
    largest = LARGEST_REST if is_complete else largest_remainder(gap.tails)
    shown = {"the poses kept aside": (gap.after.rms_m, math.hypot(gap.floor_m, gap.spread_m), largest)}
    if is_complete:
        shown["the poses that were fitted"] = place.rms_m, gap.floor_m, LARGEST_REST
    for where, (rms_m, expected_m, most) in shown.items():
        if not times_noise(rms_m, expected_m) <= most:
            is_worth_telling = gap.spread_m > LEAST_TOLD * gap.floor_m
            left_open = f", parameters leave {gap.spread_m * 1e3:.2f} mm open" if is_worth_telling else ""
            off = f"tips are {rms_m * 1e3:.2f} mm off (rms), the noise is {gap.floor_m * 1e3:.2f} mm{left_open}"
            return f"The figures contradict it: on {where} {off}."
    return ""


PERMUTATIONS = 200
CHANCE = 0.05
BINS = 4
RESOLUTION = 1000  # parts of a quantity's range: values nearer to each other are one
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
    joints = (joints - joints.mean(axis=0)) / np.maximum(joints.std(axis=0), np.finfo(float).tiny)
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
    levels = np.round(
        (values - low) / max(np.ptp(values[given]), np.finfo(float).tiny) * RESOLUTION
    )  # whatever the unit
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
