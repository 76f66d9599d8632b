"""What a fit says about itself that a person should know: bounds hit, values no tube has, conflicts with the file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ctrplan.calibration.base_parameters import BaseParameters
from ctrplan.calibration.least_squares import Fit
from ctrplan.pipeline.term import term

CONFLICT = 3.0  # standard deviations of the prior
PHYSICAL_POISSON = (0.0, 0.5)
CERTAIN = 2.0  # standard errors


@dataclass(frozen=True)
class Symptom:
    """Something that a fit says about one of its terms."""

    owner: str  # name of the term
    sentence: str


def is_strained(fit: Fit) -> bool:
    """Whether ordinary calibration had to go where no tube is: what is missing hides in it, whatever else was added."""
    return bool(strained(fit, [BaseParameters.name]))


def strained(fit: Fit, names: Collection[str]) -> list[str]:
    """Those of some terms whose parameters are where they should not be: they may stand for something else."""
    owners = {symptom.owner for symptom in symptoms(fit)}
    return [name for name in names if name in owners]


def symptoms(fit: Fit) -> list[Symptom]:
    """Of every parameter; what is plausible is what the effects say, however wide the priors of the fit are."""
    found = []
    spread = np.sqrt(np.diag(fit.covariance))
    plausible = [term(t.effect, [q.name for q in t.parameters], fit.chain.robot).parameters for t in fit.chain.terms]
    parameters = [(t.name, q) for t, own in zip(fit.chain.terms, plausible, strict=True) for q in own]
    for j, (owner, parameter) in enumerate(parameters):
        value, error = fit.p[j] / parameter.si, spread[j] / parameter.si
        shown = f"{owner}: {parameter.name} = {value:.4g}"
        if fit.at_bound[j] and abs(value - parameter.neutral) > 1e-9:
            found.append(Symptom(owner, f"{shown} is at the end of its range."))
        elif parameter.name.startswith("poisson_ratio"):
            low, high = PHYSICAL_POISSON
            if value + CERTAIN * error < low or value - CERTAIN * error > high:
                outside = f"outside {low:g} to {high:g}, which no tube has: something else hides in it"
                found.append(Symptom(owner, f"{shown} is {outside}."))
        if abs(value - parameter.neutral) > CONFLICT * parameter.prior:
            times = f"more than {CONFLICT:g} times what is plausible"
            found.append(Symptom(owner, f"{owner}: {parameter.name} is {times} away from {parameter.neutral:g}."))
    return found
