"""What a fit says about itself that a person should know: bounds hit, values no tube has, conflicts with the file."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ctrplan.calibration.base_parameters import BaseParameters
from ctrplan.calibration.least_squares import Fit

CONFLICT = 3.0  # standard deviations of the prior
PHYSICAL_POISSON = (0.0, 0.5)
CERTAIN = 2.0  # standard errors


def is_strained(fit: Fit) -> bool:
    """Whether ordinary calibration had to go where no tube is: what is missing hides in it, whatever else was added."""
    return bool(strained(fit, [BaseParameters.name]))


def strained(fit: Fit, names: Collection[str]) -> list[str]:
    """Those of some terms whose parameters are where they should not be: they may stand for something else."""
    owners = {sentence.split(":")[0] for sentence in symptoms(fit)}
    return [name for name in names if name in owners]


def symptoms(fit: Fit) -> list[str]:
    """One sentence each."""
    found = []
    spread = np.sqrt(np.diag(fit.covariance))
    names = [(t.name, p) for t in fit.chain.terms for p in t.parameters]
    for j, (owner, parameter) in enumerate(names):
        value, error = fit.p[j] / parameter.si, spread[j] / parameter.si
        shown = f"{owner}: {parameter.name} = {value:.4g}"
        if fit.at_bound[j] and abs(value - parameter.neutral) > 1e-9:
            found.append(f"{shown} is at the end of its range.")
        elif parameter.name.startswith("poisson_ratio"):
            low, high = PHYSICAL_POISSON
            if value + CERTAIN * error < low or value - CERTAIN * error > high:
                found.append(f"{shown} is outside {low:g} to {high:g}, which no tube has: something else hides in it.")
        if abs(value - parameter.neutral) > CONFLICT * parameter.prior:
            times = f"more than {CONFLICT:g} times what is plausible"
            found.append(f"{owner}: {parameter.name} is {times} away from {parameter.neutral:g}.")
    return found
