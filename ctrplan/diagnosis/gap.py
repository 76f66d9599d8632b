"""The held-out set: poses that nothing has seen, before and after the effects were added, over all and by region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.pose_errors import Errors, distances, summary
from ctrplan.calibration.residuals import Noise, Residuals, residuals
from ctrplan.calibration.unsolved import excused
from ctrplan.diagnosis.chi_square import ChiSquare, outliers
from ctrplan.diagnosis.rescaled_noise import HEAVY, tail_weight
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.friction_path import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.prediction import Prediction


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


def open_held_out_set(
    before: Fit, after: Fit, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise
) -> Gap:
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
    found = _residuals(effective_there.subset(kept), held_out_set.subset(kept), group[kept], noise)
    outlying, near = np.zeros(len(kept), bool), ~outliers(found.raw_norm)
    outlying[np.flatnonzero(kept)[~near]] = True
    kept &= ~outlying
    held_out_set, group = held_out_set.subset(kept), group[kept]
    errors = [distances(prediction.subset(kept), held_out_set) for prediction in predictions]
    regions = {
        name: (summary(errors[1][inside], group[inside]), summary(errors[2][inside], group[inside]))
        for name, inside in _regions(held_out_set).items()
    }
    nominal, calibrated, effective = (summary(e, group) for e in errors)
    chi_square = _predictive(found.r[near][found.given[near]], found.J[near][found.given[near]], after)
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


def _residuals(prediction: Prediction, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise) -> Residuals:
    whitening: Sequence[int] | NDArray[np.int_] = np.arange(len(group)) if held_out_set.is_stream else group
    return residuals(held_out_set, prediction, noise, whitening)


def _predictive(r: Array, J: Array, after: Fit) -> ChiSquare:
    """Residuals (R,) with derivatives (R, P) over noise and the parameters' own uncertainty together."""
    spread = np.eye(len(r)) + J @ after.covariance @ J.T
    return ChiSquare(float(r @ np.linalg.solve(spread, r)), len(r))
