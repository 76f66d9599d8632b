"""Noise of another size than stated: the same everywhere, while a missing effect is not."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2, f

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise, Residuals
from ctrplan.diagnosis.chi_square import REJECTED, Adequacy, ChiSquare, outliers

UNEVEN = 0.01  # probability of a ratio of between to within below which the excess has structure
LARGEST_FACTOR = 3.0
HEAVY = 2.0  # tail weight that 60 poses of Gaussian noise have once in a thousand
LEAST_CHANGE = 1.05  # factors nearer to 1 change nothing


def rescaled_noise(left: Adequacy, noise: Noise, norm: Array, given: Array) -> tuple[Noise | None, str]:
    """Noise as the residuals show it, if they differ from the stated one and are even; and a sentence about it.

    Even: as large between configurations as between approaches of one. An effect that the model lacks acts on one of
    the two, because it belongs to the configuration or to the way there. Residuals, with norms per pose `norm` (K,) of
    `given` (K,) measured numbers each, that are small but for heavy tails say nothing against the stated size: the
    tails are part of it.
    """
    small = _too_small(left.total) < REJECTED
    if not (small or left.total.p < REJECTED) or not _is_even(left):
        return None, ""
    if small and tail_weight(norm, given) > HEAVY:
        return None, "The noise has heavier tails than a Gaussian; its size is taken as stated."
    factors = [math.sqrt(part.ratio) if part.dof > 1 else 1.0 for part in (left.position, left.tangent)]
    if (
        max(factors) > LARGEST_FACTOR
        or min(factors) < 1 / LARGEST_FACTOR
        or all(abs(x - 1) < LEAST_CHANGE - 1 for x in factors)
    ):
        return None, ""
    found = Noise(noise.position_m * factors[0], noise.tangent_rad * factors[1])
    sentence = (
        f"The noise is not as stated: {found.position_m * 1e3:.3g} mm and {math.degrees(found.tangent_rad):.3g} deg "
        f"fit the data, the file says {noise.position_m * 1e3:.3g} mm and {math.degrees(noise.tangent_rad):.3g} deg."
    )
    return found, sentence


def tail_weight(norm: Array, given: Array) -> float:
    """Variance of squared norms (K,) of poses over what it is for Gaussian noise of their size: 1 without tails.

    `given` (K,) counts the numbers of each pose that were measured.
    """
    square = norm**2 / given
    return float(np.var(square) / np.mean(square) ** 2 / np.mean(2 / given))


def held_out_probability(held_out_set: ChiSquare, left: ChiSquare, residuals: Residuals, *, estimated: bool) -> float:
    """Probability of a held-out set as far off as this, given what is `left` of the selection, whose residuals follow.

    Where the noise is an estimate from the selection it is F instead of chi-square. Tails heavier than Gaussian make
    sums of squares less certain: degrees of freedom shrink with the kurtosis (Box and Andersen 1955).
    """
    near, given = ~outliers(residuals.raw_norm), residuals.given.sum(axis=1)
    kept = residuals.norm[near], given[near]
    if estimated:
        excess = max(1.0, tail_weight(*kept))
        return float(f.sf(held_out_set.ratio / left.ratio, held_out_set.dof / excess, left.dof / excess))
    if tail_weight(*kept) < HEAVY:
        return held_out_set.p
    excess = tail_weight(residuals.norm, given)  # with the far ones, which a small held-out set can't tell as such
    return float(chi2.sf(held_out_set.value / excess, held_out_set.dof / excess))


def _is_even(left: Adequacy) -> bool:
    if min(left.between.dof, left.within.dof) < 10:
        return False
    ratio = left.between.ratio / left.within.ratio
    above = float(f.sf(ratio, left.between.dof, left.within.dof))
    return min(above, 1 - above) > UNEVEN / 2


def _too_small(found: ChiSquare) -> float:
    return float(chi2.cdf(found.value, found.dof))
