"""Fitted parameters with 95 % confidence intervals, in the units that their names end with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ctrplan.calibration.least_squares import Fit
from ctrplan.pipeline.term import Term

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
    found: dict[str, Estimate] = {}
    for t, place in zip(fit.chain.terms, fit.chain.slices(), strict=True):
        if t.key != term.key:
            continue
        for j, parameter in zip(range(place.start, place.stop), t.parameters, strict=True):
            value, wide = fit.p[j] / parameter.si, spread[j] / parameter.si
            low, high = max(value - wide, parameter.lower), min(value + wide, parameter.upper)
            numbers = (min(max(_rounded(x), parameter.lower), parameter.upper) for x in (value, low, high))
            shown, *ends = numbers  # rounding must not leave the range: robot files are checked
            found[parameter.name] = Estimate(shown, (ends[0], ends[1]), bool(fit.at_bound[j]))
    return found


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
