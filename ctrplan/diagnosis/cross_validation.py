"""Grouped cross-validation of a fit in closed form around it.

With r = y - J p and H = J^T W J + prior, leaving a fold out moves its own residual to
r_f + J_f (H - J_f^T W J_f)^-1 J_f^T W r_f: one factorisation per fold, no refit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import PER_POSE, information_inverse, robust_square


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
        return Linear(
            self.r, self.J[:, :, chosen], self.weight, self.precision[chosen], self.offset[chosen], self.given
        )

    def without(self, gone: NDArray[np.bool_]) -> Linear:
        """With some of the parameters, mask (P,), back at the priors' centres, and no longer fitted."""
        back = Linear(
            self.r + self.J[:, :, gone] @ self.offset[gone],
            self.J,
            self.weight,
            self.precision,
            self.offset,
            self.given,
        )
        return back.columns(np.flatnonzero(~gone).tolist())

    def refitted(self) -> Linear:
        """After one Gauss-Newton step."""
        H, gradient = self._system()
        step = solved(H, gradient - self.precision * self.offset)
        return Linear(self.r - self.J @ step, self.J, self.weight, self.precision, self.offset + step, self.given)

    def covariance(self) -> Array:
        """(P, P) of the parameters."""
        root = information_inverse(self.J, self.weight, self.precision)
        covariance: Array = root @ root.T
        return covariance

    def _system(self) -> tuple[Array, Array]:
        J, w = self.J.reshape(-1, self.J.shape[2]), np.repeat(self.weight, PER_POSE)
        return J.T @ (w[:, None] * J) + np.diag(self.precision), J.T @ (w * self.r.ravel())


def left_out_residuals(fit: Linear, fold: NDArray[np.int_]) -> Array:
    """(K, 5) every pose's residual when its fold (K,) had not been fitted."""
    H, _ = fit._system()
    left = np.empty_like(fit.r)
    for number in np.unique(fold):
        inside = fold == number
        moved = _left_out(fit.J[inside], fit.weight[inside], H, fit.r[inside].reshape(-1, 1))
        left[inside] = moved.reshape(-1, PER_POSE)
    return left


def steps_without(fit: Linear, fold: NDArray[np.int_]) -> dict[int, Array]:
    """By number of each fold (K,), how far (P,) the parameters move when it had not been fitted."""
    H, _ = fit._system()
    steps = {}
    for number in np.unique(fold).tolist():
        inside = fold == number
        flat, w = fit.J[inside].reshape(-1, fit.J.shape[2]), np.repeat(fit.weight[inside], PER_POSE)[:, None]
        steps[number] = -solved(H - flat.T @ (w * flat), flat.T @ (w[:, 0] * fit.r[inside].ravel()))
    return steps


def cross_validation_loss(fit: Linear, fold: NDArray[np.int_]) -> Array:
    """(K,) robust square of every pose's residual when its fold (K,) had not been fitted."""
    return robust_square(np.linalg.norm(left_out_residuals(fit, fold), axis=1))


def _left_out(J: Array, weight: Array, H: Array, r: Array) -> Array:
    """Residuals (5 k, D) of a fold when it is left out of the fit."""
    flat, w = J.reshape(-1, J.shape[2]), np.repeat(weight, PER_POSE)[:, None]
    moved: Array = r + flat @ solved(H - flat.T @ (w * flat), flat.T @ (w * r))
    return moved


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
