"""Whether what remains after a fit is noise: chi-square of all, of configurations, of contrasts between approaches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ctrplan.base.arrays import Array
from ctrplan.calibration.gross_outliers import OUTLIER
from ctrplan.calibration.residuals import PER_POSE, information_inverse
from ctrplan.calibration.unsolved import excused
from ctrplan.diagnosis.held_out import Linear
from ctrplan.diagnosis.workbench import Scored, Workbench, linear

REJECTED = 1e-3  # probability below which a chi-square is no chance
MOST_OUTLIERS = 0.03  # of the poses, and one in any case; more are no outliers but a misfit


@dataclass(frozen=True)
class ChiSquare:
    """A sum of squares with its expectation under noise."""

    value: float
    dof: float

    @property
    def ratio(self) -> float:
        """1 for noise as stated."""
        return self.value / max(self.dof, 1e-9)

    @property
    def p(self) -> float:
        """Probability of at least this under noise."""
        return float(chi2.sf(self.value, max(self.dof, 1e-9)))

    @property
    def is_noise(self) -> bool:
        """Whether noise of the stated size explains it."""
        return self.p > REJECTED


@dataclass(frozen=True)
class Adequacy:
    """What remains, apart: between configurations, and between approaches of one configuration."""

    total: ChiSquare
    between: ChiSquare
    within: ChiSquare
    position: ChiSquare
    tangent: ChiSquare

    @property
    def is_adequate(self) -> bool:
        """Whether nothing but noise is left, in all, between configurations and within them."""
        return self.total.is_noise and self.between.is_noise and self.within.is_noise


def outliers(norm: Array) -> NDArray[np.bool_]:
    """(K,) poses too far off for noise, if they are few."""
    far = norm > OUTLIER
    return far if far.sum() <= math.ceil(MOST_OUTLIERS * len(far)) else np.zeros_like(far)


def ignored(scored: Scored) -> NDArray[np.bool_]:
    """(K,) poses of a fit that its chi-squares leave out: without a solution, or outliers of the others."""
    left = excused(scored.failed).copy()
    left[~left] = outliers(scored.fit.residuals.raw_norm[~left])
    return left


def adequacy(fit: Linear, group: NDArray[np.int_], ignored: NDArray[np.bool_]) -> Adequacy:
    """Of a linearised fit's residuals; `group` (K,) numbers configurations; some poses (K,) are left out."""
    r, J, group, given = fit.r[~ignored], fit.J[~ignored], group[~ignored], fit.given[~ignored]
    root = information_inverse(fit.J, fit.weight, fit.precision)
    hat = J @ root  # (K, 5, P): hat hat^T is the share of noise that the fit took
    means, mean_hats = _group_means(r, group, given), _group_means(hat, group, given)
    total = ChiSquare(float((r**2).sum()), given.sum() - _taken(hat))
    between = ChiSquare(float((means**2).sum()), _group_sums(given, group).astype(bool).sum() - _taken(mean_hats))
    within = ChiSquare(total.value - between.value, total.dof - between.dof)
    parts = (slice(0, 3), slice(3, PER_POSE))
    position, tangent = (
        ChiSquare(float((r[:, part] ** 2).sum()), given[:, part].sum() - _taken(hat[:, part])) for part in parts
    )
    return Adequacy(total, between, within, position, tangent)


def _taken(hat: Array) -> float:
    """Degrees of freedom that a fit takes: one a parameter at most, which small robust weights would exceed."""
    return min(float((hat**2).sum()), float(hat.shape[2]))


def remains(bench: Workbench, scored: Scored) -> Adequacy:
    """What is left of the selection's poses after a fit."""
    return adequacy(linear(scored.fit), bench.group, ignored(scored))


def _group_means(values: Array, group: NDArray[np.int_], given: NDArray[np.bool_]) -> Array:
    """Sums over groups over the root of what was measured there: an orthonormal projection of independent poses."""
    count = np.maximum(_group_sums(given, group), 1)
    means: Array = _group_sums(values, group) / np.sqrt(count.reshape(*count.shape, *[1] * (values.ndim - 2)))
    return means


def _group_sums(values: Array | NDArray[np.bool_], group: NDArray[np.int_]) -> Array:
    numbers, number = np.unique(group, return_inverse=True)
    sums = np.zeros((len(numbers), *values.shape[1:]))
    np.add.at(sums, number, values)
    return sums
