"""The gap on the test set before and after effects were added, and the rule that no verdict is greener than its
figures.
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
from ctrplan.diagnosis.linear_fit import solved
from ctrplan.diagnosis.remainder import Place
from ctrplan.diagnosis.verdict import Verdict
from ctrplan.measurement.measurements import Measurements
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
    correction: tuple[Array, Array] | None  # of all its poses: what friction states leave out, with the effects


def open_test_set(before: Fit, after: Fit, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise) -> Gap:
    """Predicts the held-out set's poses with fits that have not seen them; where one has no solution, none is asked.

    Few poses too far off for noise are in no figure: what chi-squares leave out, errors leave out as well.
    """
    chains = [ParametricChain(f.chain.robot, held_out_set, f.chain.terms) for f in (before, before, after)]
    values = (before.chain.neutral, before.p, after.p)
    for chain, p in zip(chains[1:], values[1:], strict=True):
        chain.correction = friction_correction(chain, p)
    correction, effective_there = chains[2].correction, chains[2].predict(after.p)
    predictions = [chain.predict(p, derivatives=False) for chain, p in zip(chains[:2], values[:2], strict=True)]
    predictions.append(effective_there)
    failed = predictions[1].failed | predictions[2].failed
    kept = ~excused(failed)
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
        correction,
    )


def rms_there_m(fit: Fit, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise, like: Gap) -> float:
    """Rms distance of the held-out set's poses by a like fit, with friction states as a gap has them.

    Poses that either leaves without a solution, and its own outliers, are left out.
    """
    chain = ParametricChain(fit.chain.robot, held_out_set, fit.chain.terms)
    chain.correction = like.correction if chain.robot_at(fit.p).friction.any() else None
    there = chain.predict(fit.p, derivatives=False)
    kept = ~excused(like.failed | there.failed)
    result = _residuals(there.subset(kept), held_out_set.subset(kept), group[kept], noise)
    error = distances(there.subset(kept), held_out_set.subset(kept))[~outliers(result.raw_norm)]
    return float(np.sqrt(np.mean(error**2)))


def _tails(fitted: Residuals) -> float:
    near = ~outliers(fitted.raw_norm)
    weight = tail_weight(fitted.norm[near], fitted.given.sum(axis=1)[near]) if near.any() else 1.0
    return weight if weight > HEAVY else 1.0


def _spread_m(position_by: Array, after: Fit) -> float:
    """Rms distance, of positions with derivatives (V, 3, P), within the covariance of the parameters."""
    per_pose = ((position_by @ after.covariance) * position_by).sum(axis=(1, 2))
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
    along = J.T @ r
    taken = along @ solved(after.information + J.T @ J, along)  # r^T (1 + J H^-1 J^T)^-1 r by Woodbury's identity
    return ChiSquare(float(r @ r - taken), len(r))


LARGEST_REST = 1.5  # of the noise: rms error with which a model still agrees with measurements


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
            left_open = f", parameters leave {gap.spread_m * 1e3:.2f} mm open"
            off = f"tips are {rms_m * 1e3:.2f} mm off (rms), the noise is {gap.floor_m * 1e3:.2f} mm{left_open}"
            return f"The figures contradict it: on {where} {off}."
    return ""
