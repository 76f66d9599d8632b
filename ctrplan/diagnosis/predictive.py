"""How probable blocks are that a fit has not seen, with what its parameters are uncertain by in the covariance.

Of a block b in a fold that is left out, the residuals that a fit of the other folds leaves have the covariance
S = I + J_b C J_b^T, C that of the parameters of this fit. The loss is r^T S^-1 r + log det S, pose by pose along the
Cholesky factor. A square alone counts a prediction that is known to be vague as a bad one: poses that stand apart then
decide, and chance is large because a few of them are hit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import PER_POSE, robust_square
from ctrplan.diagnosis.held_out import Linear, solved


def predictive_loss(fit: Linear, fold: NDArray[np.int_], block: NDArray[np.int_]) -> Array:
    """(K,) minus twice the logarithm of every pose's density when its fold (K,) had not been fitted, robust.

    block (K,): poses that are asked together, each within one fold.
    """
    loss = np.empty(len(fit.r))
    for poses, white, log_size in _left_out(fit, fit.weight, fold, block, fit.r.reshape(-1, 1)):
        square = robust_square(np.linalg.norm(white.reshape(-1, PER_POSE), axis=1))
        loss[poses] = square + log_size.reshape(-1, PER_POSE).sum(axis=1)
    return loss


def predictive_null_scores(fit: Linear, fold: NDArray[np.int_], block: NDArray[np.int_], noise: Array) -> Array:
    """(D,) the score, minus half the loss, of D draws of noise (5 K, D) after a fit of the same parameters."""
    flat = fit.J.reshape(-1, fit.J.shape[2])
    noise = noise * fit.given.reshape(-1, 1)
    r = noise - flat @ solved(flat.T @ flat + np.diag(fit.precision), flat.T @ noise)
    score = np.zeros(noise.shape[1])
    for _, white, log_size in _left_out(fit, np.ones(len(fit.r)), fold, block, r):
        score -= ((white**2).sum(axis=0) + log_size.sum()) / 2
    return score


def _left_out(
    fit: Linear, weight: Array, fold: NDArray[np.int_], block: NDArray[np.int_], r: Array
) -> Iterator[tuple[NDArray[np.int_], Array, Array]]:
    """Poses (k,) of every block, its residuals (5 k, D) over S, and twice the logarithms (5 k,) of their sizes.

    r (5 K, D): residuals of the whole fit.
    """
    flat, w = fit.J.reshape(-1, fit.J.shape[2]), np.repeat(weight, PER_POSE)[:, None]
    H = flat.T @ (w * flat) + np.diag(fit.precision)
    for number in np.unique(fold):
        left = np.flatnonzero(fold == number)
        rows = numbers(left)
        J, by = flat[rows], w[rows] * flat[rows]
        spread = solved(H - J.T @ by, J.T).T  # (5 f, P) derivatives times the covariance without the fold
        moved = r[rows] + spread @ (by.T @ r[rows])
        for member in np.unique(block[left]):
            mine = np.flatnonzero(block[left] == member)
            own = numbers(mine)
            S = np.eye(len(own)) + spread[own] @ J[own].T
            factor = np.linalg.cholesky((S + S.T) / 2)
            white = solve_triangular(factor, moved[own], lower=True, check_finite=False)
            yield left[mine], white, 2 * np.log(np.diag(factor))


def numbers(poses: NDArray[np.int_]) -> NDArray[np.int_]:
    """Of poses (k,), the rows (5 k,) of their numbers."""
    rows: NDArray[np.int_] = (PER_POSE * poses[:, None] + np.arange(PER_POSE)).ravel()
    return rows
