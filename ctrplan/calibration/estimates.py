"""Estimates of a fit with 95 % intervals, combinations that the data can not tell, and errors of poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import CI95, LEVEL, Array
from ctrplan.base.package import shown
from ctrplan.calibration.least_squares import Fit
from ctrplan.effects.learned.learned import DIGITS
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import SensorPrediction, Term

SHOWN_DIGITS = 2  # of half an interval


@shown
@dataclass(frozen=True)
class Estimate:
    """A parameter in the unit that its name ends with."""

    value: float
    ci95: tuple[float, float]
    at_bound: bool = False

    @property
    def shown(self) -> str:
        """The value for a reader, as in `shown_ci95`."""
        return self._in_digits(self.value)

    @property
    def shown_ci95(self) -> str:
        """The interval for a reader, its half width to two digits; words where it has no width."""
        if not self.ci95[1] > self.ci95[0]:
            return "at the end of its range" if self.at_bound else "no interval"
        return f"{self._in_digits(self.ci95[0])} to {self._in_digits(self.ci95[1])}"

    def differs_from(self, value: float) -> bool:
        """Whether the interval leaves a value out."""
        return not self.ci95[0] <= value <= self.ci95[1]

    def _in_digits(self, number: float) -> str:
        half = (self.ci95[1] - self.ci95[0]) / 2
        if not 0 < half < np.inf:
            return f"{number:.4g}"
        return f"{number:.{max(0, SHOWN_DIGITS - 1 - math.floor(math.log10(half)))}f}"


def estimates(fit: Fit, term: Term) -> dict[str, Estimate]:
    """The parameters of one term of a fit, with 95 % intervals inside their bounds."""
    spread = CI95 * np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    results: dict[str, Estimate] = {}
    for t, place in zip(fit.chain.terms, fit.chain.slices(), strict=True):
        if t.key != term.key:
            continue
        for j, parameter in zip(range(place.start, place.stop), t.parameters, strict=True):
            value, wide = fit.p[j] / parameter.si, spread[j] / parameter.si
            low, high = max(value - wide, parameter.lower), min(value + wide, parameter.upper)
            rounded = (_rounded(x, high - low) for x in (value, low, high))
            numbers = (min(max(x, parameter.lower), parameter.upper) for x in rounded)
            shown, *ends = numbers  # rounding must not leave the range: robot files are checked
            results[parameter.name] = Estimate(shown, (ends[0], ends[1]), bool(fit.at_bound[j]))
    return results


def _rounded(value: float, width: float) -> float:
    """A number to so many decimals that an interval of this width has DIGITS digits, and its ends stay apart."""
    if not 0 < width < math.inf:
        return float(f"{value:.{DIGITS}g}")
    return round(float(value), DIGITS - 1 - math.floor(math.log10(width)))


UNKNOWN = 0.7  # of the prior's standard deviation that data leave: they say little about this combination
SHOWN = 0.3  # of a unit vector's component that makes a parameter part of a combination


@dataclass(frozen=True)
class Combination:
    """A direction in the space of parameters over their priors, and what the data leave of its uncertainty."""

    parameters: dict[str, float]  # components of a unit vector, the largest ones
    posterior_share: float  # standard deviation after the data over the one before, 0 to 1

    @property
    def is_known(self) -> bool:
        """Whether the data say more of it than the prior did."""
        return self.posterior_share < UNKNOWN


def combinations(fit: Fit) -> list[Combination]:
    """All of them, the least known first."""
    J = fit.residuals.J * np.sqrt(fit.residuals.weight)[:, None, None]
    scaled = J.reshape(-1, J.shape[2]) * fit.chain.prior
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    names = [parameter.name for parameter in fit.chain.parameters]
    results = []
    for value, direction in sorted(zip(singular.tolist(), directions, strict=True), key=lambda pair: pair[0]):
        parts = {n: round(float(x), 3) for n, x in zip(names, direction, strict=True) if abs(x) > SHOWN}
        results.append(Combination(parts, float(1 / np.sqrt(1 + value**2))))
    return results


RESAMPLES, SEED = 400, 2
SPAN_PERCENT = (50 - 50 * LEVEL, 50 + 50 * LEVEL)


@dataclass(frozen=True)
class Errors:
    """3-D distances [m] over poses; the interval of the rms is from resampled configurations."""

    mean_m: float
    rms_m: float
    p95_m: float
    max_m: float
    rms_ci95_m: tuple[float, float] | None  # None of one configuration, which says nothing of others
    poses: int


def distances(prediction: SensorPrediction, data: Measurements) -> Array:
    """(K,) distance [m] of measured from predicted points; from the base where the prediction is not finite.

    Of a marker seen along an axis it is the distance in the plane across.
    """
    seen = data.given[:, :3]
    measured = np.where(seen, data.position_m, 0.0)
    distance = np.linalg.norm(np.where(seen, prediction.position_m, 0.0) - measured, axis=1)
    wrong: Array = np.where(np.isfinite(distance), distance, np.linalg.norm(measured, axis=1))
    return wrong


def summary(error: Array, group: NDArray[np.int_]) -> Errors:
    """The summary of distances (K,), configurations (K,) resampled whole."""
    numbers = np.unique(group)
    squares = np.array([np.sum(error[group == number] ** 2) for number in numbers])
    counts = np.array([np.sum(group == number) for number in numbers])
    picks = np.random.default_rng(SEED).integers(0, len(numbers), (RESAMPLES, len(numbers)))
    resampled = np.sqrt(squares[picks].sum(axis=1) / counts[picks].sum(axis=1))
    low, high = np.percentile(resampled, SPAN_PERCENT).tolist()
    interval = (low, high) if high > low else None
    rms = float(np.sqrt(np.mean(error**2)))
    return Errors(float(error.mean()), rms, float(np.percentile(error, 95)), float(error.max()), interval, len(error))
