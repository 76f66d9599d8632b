"""What a person should know of a fit: bounds hit, implausible values, gross outliers, poses without a solution.

A pose has gone wrong if it is far off for noise, far off compared with the others, and far off compared with its
companions: what a model lacks shows in other approaches of the same configuration, or just before and after, as well.
The fits that say how far off it is are robust, so that a pose pulls at them as one of 4.5 standard deviations would.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import distances
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.observed_noise import SURE
from ctrplan.calibration.parameters import BaseParameters
from ctrplan.calibration.residuals import residuals
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import simulated
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import term
from ctrplan.robot.named_numbers import MOST_RATIO

PHYSICAL_POISSON = (0.0, MOST_RATIO)
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
    """Terms whose parameters are where they should not be: they may stand for something else."""
    owners = {symptom.owner for symptom in symptoms(fit)}
    return [name for name in names if name in owners]


def symptoms(fit: Fit) -> list[Symptom]:
    """Symptoms of every parameter; effects say what is plausible, however wide the priors of the fit are."""
    results = []
    spread = np.sqrt(np.diag(fit.covariance))
    plausible = [term(t.effect, [q.name for q in t.parameters], fit.chain.robot).parameters for t in fit.chain.terms]
    parameters = [(t.name, q) for t, own in zip(fit.chain.terms, plausible, strict=True) for q in own]
    for j, (owner, parameter) in enumerate(parameters):
        value, error = fit.p[j] / parameter.si, spread[j] / parameter.si
        shown = f"{owner}: {parameter.name} = {value:.4g}"
        if fit.at_bound[j] and abs(value - parameter.neutral) > 1e-9:
            results.append(Symptom(owner, f"{shown} is at the end of its range."))
        elif parameter.name.startswith("poisson_ratio"):
            low, high = PHYSICAL_POISSON
            if value + CERTAIN * error < low or value - CERTAIN * error > high:
                outside = f"outside {low:g} to {high:g}, which no tube has: something else hides in it"
                results.append(Symptom(owner, f"{shown} is {outside}."))
        if abs(value - parameter.neutral) > SURE * parameter.prior:
            times = f"more than {SURE:g} times what is plausible"
            results.append(Symptom(owner, f"{owner}: {parameter.name} is {times} away from {parameter.neutral:g}."))
    return results


OF_A_TUBE = {"precurvature": "as curved", "stiffness": "as stiff"}  # by the first word of a parameter


def other_tubes(fit: Fit) -> list[str]:
    """Clauses about tubes that are not those of the file: calibrated, they are farther off than such tubes differ.

    "tube 2 is not the tube of the file: 1.68 times as curved (precurvature_factor_2_2 = 1.68)"
    """
    spread, clauses = np.sqrt(np.diag(fit.covariance)), dict[str, str]()
    known = [(t.name, q) for t in fit.chain.terms for q in t.parameters]
    for j, (owner, parameter) in enumerate(known):
        kind, _, place = parameter.name.partition("_factor_")
        factor, tube = float(fit.p[j] / parameter.si), place.partition("_")[0]
        off = abs(factor - parameter.neutral)
        if owner != BaseParameters.name or kind not in OF_A_TUBE or off <= SURE * parameter.prior:
            continue
        if spread[j] / parameter.si < parameter.prior and tube not in clauses:
            says = f"{factor:.3g} times {OF_A_TUBE[kind]} ({parameter.name} = {factor:.3g})"
            clauses[tube] = f"tube {tube} is not the tube of the file: {says}"
    return list(clauses.values())


MOST_FAILED = 1 / 3  # of the poses; a model without a solution at more of them explains nothing


def excused(failed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(K,) poses without a solution that are left out of chi-squares and errors: all, unless they are too many."""
    return failed if failed.mean() <= MOST_FAILED else np.zeros_like(failed)


def unsolved_sentence(
    data: Measurements, failed: NDArray[np.bool_], counted: NDArray[np.bool_], models: str
) -> list[str]:
    """About the poses (K,) at which a model failed, if any; `counted` are those that chi-squares and errors count."""
    if not failed.any():
        return []
    kept = int((failed & counted).sum())
    which = f"{kept} of them, too many to be left out, count as wrong" if kept else "they are left out"
    where = f"{failed.sum()} of {data.count} poses, {models} (row {data.rows_in_words(failed)})"
    return [f"The solver found no equilibrium at {where}: in chi-squares and errors {which}."]


OUTLIER = 5.6  # norm of a pose's five numbers: once in 10^5
LEAST = 2 * OUTLIER  # norm of a pose's five numbers; nearer ones are the business of chi-squares
TIMES = 4.0  # farther than what is typical of all, and of the companions
MOST_WRONG = 0.1  # of the poses; more are a misfit
REACH = 2  # poses before and after, companions where a configuration has too few


def gross_outliers(fit: Fit, data: Measurements, selected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(K,) poses of all data that went wrong, by a fit to some of them; `selected` (K,) are those to be judged."""
    judged = data.subset(selected)
    prediction = simulated(fit.chain.robot, judged, fit.chain.terms, fit.p).predict(fit.p, derivatives=False)
    norm = residuals(judged, prediction, fit.noise, np.arange(judged.count)).raw_norm
    solved = ~excused(prediction.failed)
    wrong = np.zeros(data.count, bool)
    wrong[np.flatnonzero(selected)[solved]] = far_from_all(norm[solved], judged.subset(solved))
    return wrong


def far_from_all(norm: Array, data: Measurements) -> NDArray[np.bool_]:
    """(K,) which of the norms (K,) of residuals are far beyond noise, beyond the others, and beyond companions."""
    if not len(norm):
        return np.zeros(0, bool)
    typical = np.maximum(np.median(norm), _typical_of_companions(norm, data))
    wrong: NDArray[np.bool_] = norm > np.maximum(LEAST, TIMES * typical)
    return wrong


def too_many(wrong: NDArray[np.bool_], selected: NDArray[np.bool_]) -> bool:
    """Whether so many of the poses asked about, (K,) each, went wrong that something else must be."""
    return bool(wrong.sum() > MOST_WRONG * selected.sum())


def outlier_sentences(fit: Fit, data: Measurements, wrong: NDArray[np.bool_]) -> list[str]:
    """About the poses (K,) that are left out, if any: which, and how far they are off."""
    if not wrong.any():
        return []
    left = data.subset(wrong)
    chain = ParametricChain(fit.chain.robot, left, fit.chain.terms)
    furthest_mm = distances(chain.predict(fit.p, derivatives=False), left).max() * 1e3
    poses = f"{wrong.sum()} of {data.count} poses (row {data.rows_in_words(wrong)})"
    return [f"Left out of all fits and figures because they lie far off, up to {furthest_mm:.3g} mm: {poses}."]


def _typical_of_companions(norm: Array, data: Measurements) -> Array:
    """(K,) median norm of the other approaches of a pose's configuration.

    Of less than two, that of the poses around it, or of the other approach where that is larger.
    """
    typical = np.zeros(len(norm))
    members = {number: np.flatnonzero(data.configuration == number) for number in np.unique(data.configuration)}
    for k in range(len(norm)):
        others = members[data.configuration[k]]
        others = others[others != k]
        if len(others) < 2:
            around = np.arange(max(0, k - REACH), min(len(norm), k + REACH + 1))
            twin, others = others, around[around != k]
            typical[k] = norm[twin].max(initial=0.0)
        typical[k] = max(typical[k], np.median(norm[others]) if len(others) else 0.0)
    return typical
