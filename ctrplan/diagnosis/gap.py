"""The gap on poses kept aside before and after effects were added, and what errors of calibrated tips go along with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import Errors, distances, summary
from ctrplan.calibration.fit_warnings import excused, far_from_all, too_many
from ctrplan.calibration.least_squares import Fit, fit, fit_at
from ctrplan.calibration.residuals import MODEL_POSITION_M, UNSOUND, Noise, Residuals, residuals
from ctrplan.diagnosis.conclusion import Unnamed
from ctrplan.diagnosis.hypotheses import Bench, Hypothesis
from ctrplan.measurement.approach import friction_state
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import SensorPrediction, Term

HELD = 1e-4  # of a prior, which holds a parameter where it is
COVERAGE = 0.95  # of tips of unseen runs that the radius contains


@dataclass(frozen=True, eq=False)
class Fitted:
    """A set of effects with the fit that is handed over."""

    terms: tuple[Term, ...]  # without calibration
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(t.name for t in self.terms)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(K,) poses for which the solver found no equilibrium, so that the fit says nothing about them."""
        unsound: NDArray[np.bool_] = np.isclose(self.fit.residuals.raw_norm, UNSOUND)
        return self.fit.chain.predict(self.fit.p, derivatives=False).failed if unsound.any() else unsound


def handed_over(bench: Bench, h: Hypothesis, unnamed: Unnamed) -> Fitted:
    """The hypothesis for predictions: where much is unnamed, all but its effects is calibrated again, poses alike.

    Beside errors that are alike in near poses, differences between poses count most, and tell an effect from others.
    For predictions the rest is an error as any other. The uncertainty stays that of the mixed model.
    """
    chain, p = h.chain, h.p
    kept = np.arange(bench.data.count)
    if unnamed.is_large and h.terms:
        terms = [chain.terms[0], *(fixed(t, p[s]) for t, s in zip(chain.terms[1:], chain.slices()[1:], strict=True))]
        size = math.hypot(1.0, unnamed.over_noise)
        p = _of_sound(bench, chain.with_terms(terms), p, bench.noise.scaled(size))
    elif unnamed.is_large:
        p = bench.robust.p
    p = np.clip(p, chain.lower, chain.upper)
    return Fitted(h.terms, replace(fit_at(chain, bench.noise, kept, p), posterior=h.covariance))


def calibrated(bench: Bench, base: Hypothesis) -> Fitted:
    """Without effects, every pose alike."""
    chain = base.chain
    p = np.clip(bench.robust.p, chain.lower, chain.upper)
    return Fitted((), replace(fit_at(chain, bench.noise, np.arange(bench.data.count), p), posterior=base.covariance))


def _of_sound(bench: Bench, chain: ParametricChain, p: Array, noise: Noise) -> Array:
    """(P,) fitted to the poses that did not go wrong."""
    kept = np.flatnonzero(bench.sound)
    some = ParametricChain(chain.robot, bench.data.subset(kept), chain.terms)
    some.followed_phi = None if chain.followed_phi is None else chain.followed_phi[kept]
    some.correction = None if chain.correction is None else (chain.correction[0][kept], chain.correction[1][kept])
    return fit(some, noise, np.arange(len(kept)), p).p


def fixed(t: Term, p: Array) -> Term:
    """With priors that leave its parameters (P,) where they are."""
    held = [
        replace(q, prior=HELD * q.prior, neutral=float(value) / q.si) for q, value in zip(t.parameters, p, strict=True)
    ]
    return Term(t.effect, tuple(held))


@dataclass(frozen=True)
class ChiSquare:
    """A sum of squares with its expectation under noise."""

    value: float
    dof: float

    @property
    def ratio(self) -> float:
        """1 for noise as stated."""
        return self.value / max(self.dof, 1e-9)

    @property
    def p(self) -> float:
        """Probability of at least this under noise."""
        return float(chi2.sf(self.value, max(self.dof, 1e-9)))


def chi_square(parts: Residuals) -> ChiSquare:
    """Of a fit's own residuals."""
    return ChiSquare(float((parts.r**2).sum()), float(parts.given.sum() - parts.J.shape[2]))


@dataclass(frozen=True, eq=False)
class Gap:
    """Before: calibrated, without the effects; after: with them. Regions are named in words."""

    nominal: Errors
    before: Errors
    after: Errors
    floor_m: float
    spread_m: float  # rms distance that the uncertainty of the fitted parameters leaves open, with the effects
    radius_m: float  # that contains the share COVERAGE of measured tips of unseen runs, whatever their errors' law
    regions: Mapping[str, tuple[Errors, Errors]]
    before_m: Array  # (V,) distances of the poses asked, without those that are left out
    after_m: Array
    chi_square: ChiSquare  # of these poses under noise and the uncertainty of the parameters
    failed: NDArray[np.bool_]  # of all poses asked: without a solution, before or after
    outlying: NDArray[np.bool_]  # of all poses asked: too far off for anything, left out of every figure
    is_aside: bool = True  # whether nothing had read these poses


def measured_gap(
    before: Fit, after: Fit, aside: Measurements, group: NDArray[np.int_], noise: Noise, wrong: NDArray[np.bool_]
) -> Gap:
    """Predicts poses with fits that have not seen them; where one has no solution, none is asked.

    wrong (V,): poses that are known to have gone wrong; what is as far off beside the effects is left out as well.
    """
    chains = [ParametricChain(f.chain.robot, aside, f.chain.terms) for f in (before, before, after)]
    values = (before.chain.neutral, before.p, after.p)
    for chain, p in zip(chains[1:], values[1:], strict=True):
        chain.correction = friction_correction(chain, p)
    predictions = [chain.predict(p, derivatives=False) for chain, p in zip(chains, values, strict=True)]
    failed = predictions[1].failed | predictions[2].failed
    kept = ~excused(failed)
    there = chains[2].predict(after.p)
    norm = residuals(aside, predictions[2], noise, np.arange(aside.count)).raw_norm
    outlying = np.zeros(aside.count, bool)
    outlying[kept] = far_from_all(norm[kept], aside.subset(kept))
    outlying = wrong & kept if too_many(outlying & ~wrong, kept) else outlying | (wrong & kept)
    kept &= ~outlying
    of_kept, group = aside.subset(kept), group[kept]
    parts = residuals(of_kept, there.subset(kept), noise, np.arange(of_kept.count))
    errors = [distances(prediction.subset(kept), of_kept) for prediction in predictions]
    regions = {
        name: (summary(errors[1][inside], group[inside]), summary(errors[2][inside], group[inside]))
        for name, inside in _regions(of_kept).items()
    }
    nominal, calibrated_, effective = (summary(e, group) for e in errors)
    return Gap(
        nominal,
        calibrated_,
        effective,
        noise.floor_m,
        _spread_m(there.subset(kept), after),
        conformal_radius_m(errors[2]),
        regions,
        errors[1],
        errors[2],
        _predictive(parts, after),
        failed,
        outlying,
    )


def conformal_radius_m(error_m: Array) -> float:
    """The radius that contains the next exchangeable error with probability COVERAGE: split conformal prediction.

    With fewer than 19 errors no radius does; it is the largest then.
    """
    ordered = np.sort(error_m)
    return float(ordered[min(math.ceil(COVERAGE * (len(ordered) + 1)), len(ordered)) - 1])


def _spread_m(there: SensorPrediction, after: Fit) -> float:
    """Rms distance, of positions, within the covariance of the parameters."""
    per_pose = np.einsum("kip,pq,kiq->k", there.position_by, after.covariance, there.position_by)
    return float(np.sqrt(per_pose.mean())) if len(per_pose) else 0.0


def _predictive(parts: Residuals, after: Fit) -> ChiSquare:
    """Over noise and the parameters' own uncertainty together."""
    r, J = parts.r[parts.given], parts.J[parts.given]
    covariance = np.eye(len(r)) + J @ after.covariance @ J.T
    return ChiSquare(float(r @ np.linalg.solve(covariance, r)), len(r))


LARGEST_REST = 1.5  # of the noise: rms error with which a model still agrees with measurements


def times_noise(rms_m: float, floor_m: float) -> float:
    """An rms error [m] over the noise and the solver's own error."""
    return rms_m / math.hypot(floor_m, math.sqrt(3) * MODEL_POSITION_M)


def contradiction(gap: Gap) -> str:
    """What contradicts that a model agrees with the measurements, as a sentence; empty if nothing."""
    expected_m = math.hypot(gap.floor_m, gap.spread_m)
    if times_noise(gap.after.rms_m, expected_m) <= LARGEST_REST:
        return ""
    off = f"tips are {gap.after.rms_m * 1e3:.2f} mm off (rms), noise and parameters make {expected_m * 1e3:.2f} mm"
    return f"The figures contradict it: on the poses kept aside {off}."


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


PERMUTATIONS, SEED = 200, 3
CHANCE = 0.05
BINS = 4
RESOLUTION = 1000  # parts of a quantity's range: values nearer to each other are one
TINY = 1e-300
ROUNDED_RAD = 1e-9  # by which an angle may fall short of zero without coming out as a full turn
LONGEST = 3.0  # of the median norm of residuals


@dataclass(frozen=True)
class Trend:
    """How far a quantity predicts the size of the residuals or their direction."""

    quantity: str
    share: float  # of the residuals' sum of squares explained by means over quarters of the quantity
    p: float  # probability of that much by chance, for the largest of all quantities


@dataclass(frozen=True, eq=False)
class Place:
    """Where the disagreement is."""

    trends: tuple[Trend, ...]
    sentence: str
    between_share: float  # of the sum of squares that approaches of one configuration share


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
    parts = {name: _quarters(values) for name, values in known.items()}
    observed = np.array([_share(r, part) for part in parts.values()])
    rng = np.random.default_rng(SEED)
    chance = np.array([[_share(moved, part) for part in parts.values()] for moved in _shuffles(r, group, rng)])
    z = (observed - chance.mean(axis=0)) / np.maximum(chance.std(axis=0), 1e-12)
    highest = ((chance - chance.mean(axis=0)) / np.maximum(chance.std(axis=0), 1e-12)).max(axis=1)
    trends = [
        Trend(name, float(share), float((1 + np.sum(highest >= value)) / (1 + PERMUTATIONS)))
        for name, share, value in zip(known, observed, z, strict=True)
    ]
    order = np.argsort(chance.mean(axis=0) - observed)
    ranked = tuple(trends[k] for k in order)
    between = _share(r, np.unique(group, return_inverse=True)[1])
    return Place(ranked, _sentence(opening, ranked, known, error_m, floor_m, between), between)


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


def _share(r: Array, part: NDArray[np.int_]) -> float:
    """The share of the sum of squares that means over classes explain."""
    count = np.bincount(part)
    means = np.stack([np.bincount(part, weights=column) for column in r.T], axis=1)
    return float((means**2 / np.maximum(count, 1)[:, None]).sum() / max((r**2).sum(), 1e-12))


def _bounded(r: Array) -> Array:
    """Residuals (K, 5) none of which is much longer than most: a few wild poses are no trend."""
    norm = np.linalg.norm(r, axis=1)
    longest = LONGEST * np.median(norm)
    bounded: Array = r * np.minimum(1.0, longest / np.maximum(norm, 1e-12))[:, None]
    return bounded


def _shuffles(r: Array, group: NDArray[np.int_], rng: np.random.Generator) -> list[Array]:
    """Residuals with whole configurations exchanged and approaches exchanged inside them."""
    numbers = [np.flatnonzero(group == number) for number in np.unique(group)]
    shuffled = []
    for _ in range(PERMUTATIONS):
        order = np.concatenate([rng.permutation(numbers[k]) for k in rng.permutation(len(numbers))])
        places = np.concatenate(numbers)
        moved = np.empty_like(r)
        moved[places] = r[order]
        shuffled.append(moved)
    return shuffled
