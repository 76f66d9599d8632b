"""How large what remains after a fit is over the noise: chi-square of all, of configurations, of contrasts; noise of
another size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtr, chdtrc, fdtrc  # scipy.stats takes 0.4 s to import

from ctrplan.base.arrays import Array
from ctrplan.calibration.fit_warnings import OUTLIER, excused
from ctrplan.calibration.residuals import PER_POSE, Noise, Residuals, information_inverse
from ctrplan.diagnosis.linear_fit import Linear
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
        return float(chdtrc(max(self.dof, 1e-9), self.value))


@dataclass(frozen=True)
class Adequacy:
    """What remains, apart: between configurations, and between approaches of one configuration."""

    total: ChiSquare
    between: ChiSquare
    within: ChiSquare
    position: ChiSquare
    tangent: ChiSquare


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
    """The adequacy of a linearised fit by its residuals; `group` (K,) numbers configurations; some poses (K,) are
    left out.
    """
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


UNEVEN = 0.01  # probability of a ratio of between to within below which the excess has structure
LARGEST_FACTOR = 3.0
HEAVY = 2.0  # tail weight that 60 poses of Gaussian noise have once in a thousand


def rescaled_noise(left: Adequacy, noise: Noise, norm: Array, given: Array) -> tuple[Noise | None, str]:
    """Noise as the residuals show it, if they differ from the stated one and are even; and a sentence about it.

    Even: as large between configurations as between approaches of one. An effect that the model lacks acts on one of
    the two, because it belongs to the configuration or to the way there. Residuals, with norms per pose `norm` (K,) of
    `given` (K,) measured numbers each, that are small but for heavy tails say nothing against the stated size: the
    tails are part of it.
    """
    small = float(chdtr(left.total.dof, left.total.value)) < REJECTED
    if not (small or left.total.p < REJECTED) or not _is_even(left):
        return None, ""
    if small and tail_weight(norm, given) > HEAVY:
        return None, "The noise has heavier tails than a Gaussian; its size is taken as stated."
    factors = [math.sqrt(part.ratio) if part.dof > 1 else 1.0 for part in (left.position, left.tangent)]
    if max(factors) > LARGEST_FACTOR or min(factors) < 1 / LARGEST_FACTOR:
        return None, ""
    result = Noise(noise.position_m * factors[0], noise.tangent_rad * factors[1])
    sentence = (
        f"The noise is not as stated: {result.position_m * 1e3:.3g} mm and {math.degrees(result.tangent_rad):.3g} deg "
        f"fit the data, the file says {noise.position_m * 1e3:.3g} mm and {math.degrees(noise.tangent_rad):.3g} deg."
    )
    return result, sentence


def tail_weight(norm: Array, given: Array) -> float:
    """Variance of squared norms (K,) of poses over what it is for Gaussian noise of their size: 1 without tails.

    `given` (K,) counts the numbers of each pose that were measured.
    """
    square = norm**2 / given
    return float(np.var(square) / np.mean(square) ** 2 / np.mean(2 / given))


def left_out_probability(held_out_set: ChiSquare, left: ChiSquare, residuals: Residuals, *, estimated: bool) -> float:
    """Probability of a held-out set as far off as this, given what is `left` of the selection, whose residuals follow.

    Where the noise is an estimate from the selection it is F instead of chi-square. Tails heavier than Gaussian make
    sums of squares less certain: degrees of freedom shrink with the kurtosis (Box and Andersen 1955).
    """
    near, given = ~outliers(residuals.raw_norm), residuals.given.sum(axis=1)
    kept = residuals.norm[near], given[near]
    if estimated:
        excess = max(1.0, tail_weight(*kept))
        return float(fdtrc(held_out_set.dof / excess, left.dof / excess, held_out_set.ratio / left.ratio))
    if tail_weight(*kept) < HEAVY:
        return held_out_set.p
    excess = tail_weight(residuals.norm, given)  # with the far ones, which a small held-out set can't tell as such
    return float(chdtrc(held_out_set.dof / excess, held_out_set.value / excess))


def _is_even(left: Adequacy) -> bool:
    if min(left.between.dof, left.within.dof) < 10:
        return False
    ratio = left.between.ratio / left.within.ratio
    above = float(fdtrc(left.between.dof, left.within.dof, ratio))
    return min(above, 1 - above) > UNEVEN / 2
