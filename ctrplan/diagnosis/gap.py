"""The vault: poses that nothing has seen, before and after the effects were added, over all and by region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.chain import Chain, Prediction
from ctrplan.diagnosis.guards import ChiSquare, excused, outliers
from ctrplan.drive import Array
from ctrplan.friction_path import friction_correction
from ctrplan.least_squares import Fit
from ctrplan.measurements import Measurements
from ctrplan.residuals import Noise, residuals

RESAMPLES, SEED = 400, 2
SPAN_PERCENT = (2.5, 97.5)


@dataclass(frozen=True)
class Errors:
    """3-D distances [m] over poses; the interval of the rms is from resampled configurations."""

    mean_m: float
    rms_m: float
    p95_m: float
    max_m: float
    rms_ci95_m: tuple[float, float]
    poses: int


@dataclass(frozen=True, eq=False)
class Gap:
    """Before: calibrated, without the effects; after: with them. Regions are named in words."""

    nominal: Errors
    before: Errors
    after: Errors
    floor_m: float
    regions: Mapping[str, tuple[Errors, Errors]]
    before_m: Array  # (V,) distances of the vault's poses, without those that are left out
    after_m: Array
    chi_square: ChiSquare  # of the vault's poses under the predictive distribution of the fit with the effects
    failed: NDArray[np.bool_]  # of all poses of the vault: without a solution, before or after


def distances(prediction: Prediction, data: Measurements) -> Array:
    """(K,) distance [m] of measured from predicted tips; from the base where the prediction is not finite."""
    measured = data.position_m
    distance = np.linalg.norm(prediction.position_m - measured, axis=1)
    wrong: Array = np.where(np.isfinite(distance), distance, np.linalg.norm(measured, axis=1))
    return wrong


def open_vault(before: Fit, after: Fit, vault: Measurements, group: NDArray[np.int_], noise: Noise) -> Gap:
    """Predicts the vault's poses with fits that have not seen them; where one has no solution, none is asked."""
    chains = [Chain(f.chain.robot, vault, f.chain.terms) for f in (before, before, after)]
    values = (before.chain.neutral, before.p, after.p)
    for chain, p in zip(chains[1:], values[1:], strict=True):
        chain.correction = friction_correction(chain, p)
    predictions = [chain.predict(p, derivatives=False) for chain, p in zip(chains, values, strict=True)]
    failed = predictions[1].failed | predictions[2].failed
    kept = ~excused(failed)
    vault, group = vault.subset(kept), group[kept]
    errors = [distances(prediction.subset(kept), vault) for prediction in predictions]
    regions = {
        name: (summary(errors[1][inside], group[inside]), summary(errors[2][inside], group[inside]))
        for name, inside in _regions(vault).items()
    }
    nominal, calibrated, effective = (summary(e, group) for e in errors)
    chi_square = _predictive(chains[2].predict(after.p).subset(kept), vault, after, group, noise)
    return Gap(nominal, calibrated, effective, noise.floor_m, regions, errors[1], errors[2], chi_square, failed)


def summary(error: Array, group: NDArray[np.int_]) -> Errors:
    """Of distances (K,), configurations (K,) resampled whole."""
    numbers = np.unique(group)
    squares = np.array([np.sum(error[group == number] ** 2) for number in numbers])
    counts = np.array([np.sum(group == number) for number in numbers])
    picks = np.random.default_rng(SEED).integers(0, len(numbers), (RESAMPLES, len(numbers)))
    resampled = np.sqrt(squares[picks].sum(axis=1) / counts[picks].sum(axis=1))
    low, high = np.percentile(resampled, SPAN_PERCENT).tolist()
    rms = float(np.sqrt(np.mean(error**2)))
    return Errors(
        float(error.mean()), rms, float(np.percentile(error, 95)), float(error.max()), (low, high), len(error)
    )


def _regions(vault: Measurements) -> dict[str, NDArray[np.bool_]]:
    """Thirds by extension of the innermost tube, or by time where it does not slide."""
    out = vault.l_b[vault.rows, -1]
    if np.ptp(out) < 1e-3:
        out, words = vault.rows.astype(float), ("first third", "second third", "last third")
    else:
        words = ("innermost tube retracted", "innermost tube half way", "innermost tube extended")
    edges = np.quantile(out, [1 / 3, 2 / 3])
    third = np.searchsorted(edges, out, side="right")
    return {word: third == k for k, word in enumerate(words) if np.any(third == k)}


def _predictive(
    prediction: Prediction, vault: Measurements, after: Fit, group: NDArray[np.int_], noise: Noise
) -> ChiSquare:
    """Residuals over noise and the parameters' own uncertainty together."""
    whitening: Sequence[int] | NDArray[np.int_] = np.arange(len(group)) if vault.is_stream else group
    found = residuals(vault, prediction, noise, whitening)
    ignored = outliers(found.alone)
    r, J = found.r[~ignored].ravel(), found.J[~ignored].reshape(-1, found.J.shape[2])
    spread = np.eye(len(r)) + J @ after.covariance @ J.T
    return ChiSquare(float(r @ np.linalg.solve(spread, r)), len(r))
