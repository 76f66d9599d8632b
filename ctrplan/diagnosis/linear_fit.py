"""A fit linearised around its place: one step from there, what it says of poses left out, how wide its priors are."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Linearised
from ctrplan.calibration.residuals import PER_POSE, Noise

MOST_ITERATIONS, SETTLED = 10, 0.1  # of widths, whose logarithm changes no more: a tenth of what they are known to


@dataclass(frozen=True, eq=False)
class Linear:
    """A linearised fit: whitened residuals r (K, 5), derivatives J (K, 5, P), weights (K,), prior precision (P,)."""

    r: Array
    J: Array
    weight: Array
    precision: Array
    offset: Array  # (P,) distance of the parameters from the priors' centres
    given: NDArray[np.bool_]  # (K, 5) numbers that were measured; the others are zero in r and J

    def columns(self, chosen: list[int]) -> Linear:
        """The fit with some of the parameters only."""
        return replace(self, J=self.J[:, :, chosen], precision=self.precision[chosen], offset=self.offset[chosen])

    def without(self, gone: NDArray[np.bool_]) -> Linear:
        """With some of the parameters, mask (P,), back at the priors' centres, and no longer fitted."""
        back = replace(self, r=self.r + self.J[:, :, gone] @ self.offset[gone])
        return back.columns(np.flatnonzero(~gone).tolist())

    def refitted(self) -> Linear:
        """After one Gauss-Newton step."""
        H, gradient = self._system()
        step = solved(H, gradient - self.precision * self.offset)
        return replace(self, r=self.r - self.J @ step, offset=self.offset + step)

    def centred(self, noise: Noise, root: Array) -> Linearised:
        """Residuals at the priors' centres over the noise alone, as poses count: by roots (K,)."""
        seen = self.coloured(noise)
        return Linearised(root[:, None] * (seen.r + seen.J @ self.offset), root[:, None, None] * seen.J, self.precision)

    def coloured(self, noise: Noise) -> Linear:
        """The fit over the noise alone, without the discrepancy that it was fitted beside."""
        if (rest := noise.discrepancy) is None:
            return self
        return replace(self, r=rest.coloured(self.r), J=rest.coloured(self.J))

    def _system(self) -> tuple[Array, Array]:
        J, w = self.J.reshape(-1, self.J.shape[2]), np.repeat(self.weight, PER_POSE)
        return J.T @ (w[:, None] * J) + np.diag(self.precision), J.T @ (w * self.r.ravel())


def left_out_residuals(fit: Linear, group: NDArray[np.int_]) -> Array:
    """(K, 5) residuals of every pose when its group (K,) had not been fitted.

    With r = y - J p and H = J^T W J + prior, those of a group move to r_g + J_g (H - J_g^T W J_g)^-1 J_g^T W r_g.
    """
    H, _ = fit._system()
    left = np.empty_like(fit.r)
    for number in np.unique(group):
        inside = group == number
        J, r, w = fit.J[inside].reshape(-1, len(H)), fit.r[inside].ravel(), np.repeat(fit.weight[inside], PER_POSE)
        moved = r + J @ solved(H - J.T @ (w[:, None] * J), J.T @ (w * r))
        left[inside] = moved.reshape(-1, PER_POSE)
    return left


def solved(matrix: Array, right: Array) -> Array:
    """For a symmetric matrix whose rows may differ by many orders of magnitude."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix * np.outer(scale, scale)
    shaped = scale if right.ndim == 1 else scale[:, None]
    try:
        solved: Array = shaped * cho_solve(cho_factor(scaled, check_finite=False), shaped * right, check_finite=False)
    except np.linalg.LinAlgError:  # not positive definite by rounding: what nothing determines stays where it is
        solved = shaped * np.linalg.lstsq(scaled, shaped * right, rcond=1e-13)[0]
    return solved


@dataclass(frozen=True)
class Width:
    """How wide an effect's prior most probably is, and the logarithm of what it costs to choose it."""

    over_stated: float
    cost: float

    @classmethod
    def of(cls, square: Array, unknown: Array) -> Width:
        """From k parameters' expected squares (k,) over the stated variances, and the shares of these that poses leave.

        The k numbers have the density w^-k exp(-S / 2 w^2), S their sum, and log w that of w / (1 + w^2). What the
        prior alone says of k parameters is no knowledge of w: the curvature counts those that poses determine.
        """
        k, total = len(square), float(square.sum())
        half = (total + 1 - k) / 2
        variance = (half + np.sqrt(half**2 + (k + 1) * total)) / (k + 1)
        curvature = 2 * (k - float(unknown.sum())) + 4 * variance / (1 + variance) ** 2
        density = 2 / np.pi * np.sqrt(variance) / (1 + variance)
        return cls(float(np.sqrt(variance)), -float(np.log(density * np.sqrt(2 * np.pi / curvature))))


STATED = Width(1.0, 0.0)  # of what has no parameters, and of the base's


def widths_of(fit: Linear, owners: Sequence[str], named: Collection[str]) -> dict[str, Width]:
    """How wide each effect's prior most probably is, its parameters integrated out.

    By expectation and maximisation, which never lowers the posterior of the logarithms of the widths.
    """
    H, gradient = fit._system()
    data = H - np.diag(fit.precision)
    target, of = gradient + data @ fit.offset, np.array(owners)
    places = {name: np.flatnonzero(of == name) for name in sorted(named) if name in owners}
    widths = dict.fromkeys(places, STATED)
    for _ in range(MOST_ITERATIONS):
        precision = fit.precision / np.square([widths.get(name, STATED).over_stated for name in owners])
        scale = 1 / np.sqrt(np.diag(data) + precision)
        covariance = np.linalg.inv((data + np.diag(precision)) * np.outer(scale, scale)) * np.outer(scale, scale)
        variance = np.diag(covariance)
        square, unknown = ((covariance @ target) ** 2 + variance) * fit.precision, variance * precision
        before, widths = widths, {name: Width.of(square[own], unknown[own]) for name, own in places.items()}
        if all(abs(np.log(widths[name].over_stated / before[name].over_stated)) < SETTLED for name in widths):
            break
    return widths
