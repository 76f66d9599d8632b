"""Maximum a posteriori fit of a chain's parameters: damped Gauss-Newton with priors, bounds and robust weights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise, Residuals, residuals
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import SensorPrediction, Term

MOST_STEPS = 25
ENOUGH = 0.05  # decrease of the loss (twice a log-likelihood) below which a fit has converged
VAIN = 0.5  # decrease promised by a step that was refused below which shorter ones are not tried: 0.7 standard errors
FIRST_DAMPING, LARGEST_DAMPING = 1.0, 1e6  # of steps in units of the priors: valleys are curved and long in these
LONGEST_STEP = 2.0  # of a parameter in a step, in standard deviations of its prior


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters (P,), SI, with residuals and derivatives there."""

    chain: ParametricChain
    noise: Noise
    group: NDArray[np.int_]
    p: Array
    residuals: Residuals
    converged: bool

    @property
    def precision(self) -> Array:
        """(P,) of the priors."""
        precision: Array = 1 / self.chain.prior**2
        return precision

    @property
    def loss(self) -> float:
        """Loss of the poses and of the priors."""
        return self.residuals.loss + float((self.precision * (self.p - self.chain.neutral) ** 2).sum())

    @property
    def information(self) -> Array:
        """(P, P) J^T W J plus the priors' precision."""
        return information(self.residuals) + np.diag(self.precision)

    @property
    def covariance(self) -> Array:
        """(P, P) of the parameters."""
        return inverse(self.information)

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(P,) parameters that would leave their range."""
        margin = 1e-6 * self.chain.prior
        held: NDArray[np.bool_] = (self.p <= self.chain.lower + margin) | (self.p >= self.chain.upper - margin)
        return held


def information(parts: Residuals) -> Array:
    """(P, P) J^T W J."""
    J = parts.J.reshape(-1, parts.J.shape[2])
    weighted: Array = J.T @ (np.repeat(parts.weight, parts.J.shape[1])[:, None] * J)
    return weighted


def inverse(matrix: Array) -> Array:
    """The inverse of a symmetric positive definite matrix whose rows may differ by many orders of magnitude."""
    scale = 1 / np.sqrt(np.diag(matrix))
    inverted: Array = np.linalg.pinv(matrix * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return inverted


def fit(
    chain: ParametricChain, noise: Noise, group: Sequence[int] | NDArray[np.int_], start: Array | None = None
) -> Fit:
    """The most probable parameters near `start` (P,)."""
    groups = np.asarray(group)
    p = np.clip(chain.start if start is None else start, chain.lower, chain.upper)
    here = fit_at(chain, noise, groups, p)
    damping = 0.0
    for _ in range(MOST_STEPS):
        if not len(p):
            break
        target, promised = _step(here, damping)
        if promised < ENOUGH:
            return replace(here, converged=True)
        try:
            there = fit_at(chain, noise, groups, target)
        except InputError:  # no robot has these values
            damping = max(damping * 10, FIRST_DAMPING)
            continue
        gain = here.loss - there.loss
        if gain > 0:
            here, damping = there, damping / 10 if damping > FIRST_DAMPING else 0.0
        else:
            damping = max(damping * 10, FIRST_DAMPING)
        vain = gain <= 0 and promised < VAIN
        if vain or abs(gain) < ENOUGH or damping > LARGEST_DAMPING:  # a loss this near is the solver's own noise
            return replace(here, converged=True)
    return here


def fit_at(chain: ParametricChain, noise: Noise, group: NDArray[np.int_], p: Array) -> Fit:
    """What a fit would be if `p` (P,) were its result."""
    return Fit(chain, noise, group, p, residuals(chain.data, chain.predict(p), noise, group), False)


def _step(here: Fit, damping: float) -> tuple[Array, float]:
    """The next parameters, inside their bounds, and the decrease of the loss that the linear model promises.

    Parameters held by a bound stay out of the system.
    """
    chain, parts = here.chain, here.residuals
    gradient = np.einsum("kcp,kc->p", parts.J * parts.weight[:, None, None], parts.r)
    gradient -= here.precision * (here.p - chain.neutral)
    held = ((here.p <= chain.lower) & (gradient < 0)) | ((here.p >= chain.upper) & (gradient > 0))
    free = np.flatnonzero(~held)
    step = np.zeros_like(here.p)
    matrix = here.information[np.ix_(free, free)]
    matrix = matrix + damping * np.diag(here.precision[free])
    scale = 1 / np.sqrt(np.diag(matrix))
    step[free] = scale * np.linalg.lstsq(matrix * np.outer(scale, scale), scale * gradient[free], rcond=1e-13)[0]
    limit = LONGEST_STEP * chain.prior
    stepped: Array = np.clip(here.p + np.clip(step, -limit, limit), chain.lower, chain.upper)
    return stepped, float(gradient @ (stepped - here.p))


CI95 = 1.959964  # standard deviations
DIGITS = 6
SHOWN_DIGITS = 2  # of half an interval


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
        """The interval for a reader, its half width to two digits."""
        return f"{self._in_digits(self.ci95[0])} to {self._in_digits(self.ci95[1])}"

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
            numbers = (min(max(_rounded(x), parameter.lower), parameter.upper) for x in (value, low, high))
            shown, *ends = numbers  # rounding must not leave the range: robot files are checked
            results[parameter.name] = Estimate(shown, (ends[0], ends[1]), bool(fit.at_bound[j]))
    return results


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


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
    rms = float(np.sqrt(np.mean(error**2)))
    return Errors(
        float(error.mean()), rms, float(np.percentile(error, 95)), float(error.max()), (low, high), len(error)
    )
