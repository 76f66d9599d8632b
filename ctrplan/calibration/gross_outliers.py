"""Poses that went wrong: found by a fit, and again once effects were sought, by rules that no effect fulfils.

A pose has gone wrong if it is far off for noise, far off compared with the others, and far off compared with its
companions: what a model lacks shows in other approaches of the same configuration, or just before and after, as well.
The fits that say how far off it is are robust, so that a pose pulls at them as one of 4.5 standard deviations would.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.pose_errors import distances
from ctrplan.calibration.residuals import residuals
from ctrplan.calibration.unsolved import excused
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.friction_path import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain

OUTLIER = 5.6  # norm of a pose's five numbers: once in 10^5
LEAST = 2 * OUTLIER  # norm of a pose's five numbers; nearer ones are the business of chi-squares
TIMES = 4.0  # farther than what is typical of all, and of the companions
MOST_WRONG = 0.1  # of the poses; more are a misfit
REACH = 2  # poses before and after, companions where a configuration has too few


def gross_outliers(fit: Fit, data: Measurements, asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(K,) poses of all data that went wrong, by a fit to some of them; `asked` (K,) are those to be judged."""
    judged = data.subset(asked)
    chain = ParametricChain(fit.chain.robot, judged, fit.chain.terms)
    chain.correction = friction_correction(chain, fit.p)
    prediction = chain.predict(fit.p, derivatives=False)
    norm = residuals(judged, prediction, fit.noise, np.arange(judged.count)).raw_norm
    solved = ~excused(prediction.failed)
    wrong = np.zeros(data.count, bool)
    wrong[np.flatnonzero(asked)[solved]] = far_from_all(norm[solved], judged.subset(solved))
    return wrong


def far_from_all(norm: Array, data: Measurements) -> NDArray[np.bool_]:
    """(K,) which of the norms (K,) of residuals are far beyond noise, beyond the others, and beyond companions."""
    if not len(norm):
        return np.zeros(0, bool)
    typical = np.maximum(np.median(norm), _typical_of_companions(norm, data))
    wrong: NDArray[np.bool_] = norm > np.maximum(LEAST, TIMES * typical)
    return wrong


def too_many(wrong: NDArray[np.bool_], asked: NDArray[np.bool_]) -> bool:
    """Whether so many of the poses asked about, (K,) each, went wrong that something else must be."""
    return bool(wrong.sum() > MOST_WRONG * asked.sum())


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
    """(K,) median norm of the other approaches of a pose's configuration, or of the poses around it."""
    typical = np.empty(len(norm))
    members = {number: np.flatnonzero(data.configuration == number) for number in np.unique(data.configuration)}
    for k in range(len(norm)):
        others = members[data.configuration[k]]
        others = others[others != k]
        if len(others) < 2:
            around = np.arange(max(0, k - REACH), min(len(norm), k + REACH + 1))
            others = around[around != k]
        typical[k] = np.median(norm[others]) if len(others) else 0.0
    return typical
