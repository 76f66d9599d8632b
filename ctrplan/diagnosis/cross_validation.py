"""Grouped cross-validation of a fit in closed form around it, and the largest gain that chance makes when nothing is
missing.

With r = y - J p and H = J^T W J + prior, leaving a fold out moves its own residual to
r_f + J_f (H - J_f^T W J_f)^-1 J_f^T W r_f: one factorisation per fold, no refit.

Of a block b in a fold that is left out, the residuals that a fit of the other folds leaves have the covariance
S = I + J_b C J_b^T, C that of the parameters of this fit. The loss is r^T S^-1 r + log det S, pose by pose along the
Cholesky factor. A square alone counts a prediction that is known to be vague as a bad one: poses that stand apart then
decide, and chance is large because a few of them are hit.

Chance is asked of hundreds of candidates beside one set. What that set makes of draws and blocks is found once, with
columns A; a candidate adds columns B. Of a block b whose fold is left out, with C the covariance of the set's own
parameters by the other rows R,

    B' = B_b - A_b C A_R^T B_R    precision of B's parameters  P = prior + B_R^T B_R - B_R^T A_R C A_R^T B_R

and the block's residuals over the root of its own S have the covariance I + W P^-1 W^T, W = B' over that root. So a
candidate costs in proportion to its own columns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import PER_POSE, information_inverse, robust_square
from ctrplan.measurement.measurements import SEED


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


def null_scores(fit: Linear, fold: NDArray[np.int_], noise: Array) -> Array:
    """(D,) held-out log-likelihood of D draws of pure noise (5 K, D) after a fit of the same parameters."""
    J = fit.J.reshape(-1, fit.J.shape[2])
    H = J.T @ J + np.diag(fit.precision)
    noise = noise * fit.given.reshape(-1, 1)
    r = noise - J @ solved(H, J.T @ noise)
    score = np.zeros(noise.shape[1])
    ones = np.ones(len(fit.r))
    for number in np.unique(fold):
        inside = fold == number
        rows = np.repeat(inside, PER_POSE)
        score -= (_left_out(fit.J[inside], ones[inside], H, r[rows]) ** 2).sum(axis=0) / 2
    return score


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


def predictive_loss(fit: Linear, fold: NDArray[np.int_], block: NDArray[np.int_]) -> Array:
    """(K,) minus twice the logarithm of every pose's density when its fold (K,) had not been fitted, robust.

    block (K,): poses that are asked together, each within one fold.
    """
    loss = np.empty(len(fit.r))
    for poses, white, log_size in _left_out_loss(fit, fit.weight, fold, block, fit.r.reshape(-1, 1)):
        square = robust_square(np.linalg.norm(white.reshape(-1, PER_POSE), axis=1))
        loss[poses] = square + log_size.reshape(-1, PER_POSE).sum(axis=1)
    return loss


def predictive_null_scores(fit: Linear, fold: NDArray[np.int_], block: NDArray[np.int_], noise: Array) -> Array:
    """(D,) the score, minus half the loss, of D draws of noise (5 K, D) after a fit of the same parameters."""
    flat = fit.J.reshape(-1, fit.J.shape[2])
    noise = noise * fit.given.reshape(-1, 1)
    r = noise - flat @ solved(flat.T @ flat + np.diag(fit.precision), flat.T @ noise)
    score = np.zeros(noise.shape[1])
    for _, white, log_size in _left_out_loss(fit, np.ones(len(fit.r)), fold, block, r):
        score -= ((white**2).sum(axis=0) + log_size.sum()) / 2
    return score


def _left_out_loss(
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
    """The rows (5 k,) of the numbers of poses (k,)."""
    rows: NDArray[np.int_] = (PER_POSE * poses[:, None] + np.arange(PER_POSE)).ravel()
    return rows


LEAST_SYSTEMS = 3  # for which it is worth while


def nested_null_scores(
    systems: Sequence[Linear], fold: NDArray[np.int_], block: NDArray[np.int_], noise: Array
) -> list[Array]:
    """(D,) of each system, as `predictive_null_scores`: D draws of noise (5 K, D), fold and block (K,)."""
    columns = [_columns(system) for system in systems]
    seen = Counter(column for mine in columns for column in set(mine))
    shared = {column for column, count in seen.items() if count > len(systems) / 2}
    first = next((k for k, mine in enumerate(columns) if shared and shared <= set(mine)), None)
    if len(systems) < LEAST_SYSTEMS or first is None:
        return [predictive_null_scores(system, fold, block, noise) for system in systems]
    common = systems[first].columns([k for k, column in enumerate(columns[first]) if column in shared])
    beside = _Common(common, fold, block, noise)
    results = []
    for system, mine in zip(systems, columns, strict=True):
        alike = len(mine) == len(set(mine)) and shared <= set(mine) and np.array_equal(system.given, common.given)
        own = [k for k, column in enumerate(mine) if column not in shared]
        results.append(
            beside.scores(system.columns(own)) if alike else predictive_null_scores(system, fold, block, noise)
        )
    return results


def _columns(system: Linear) -> list[bytes]:
    """What makes a parameter the same one in two systems: its derivatives and its prior."""
    J = np.ascontiguousarray(np.moveaxis(system.J, 2, 0))
    return [J[k].tobytes() + system.precision[k].tobytes() for k in range(len(J))]


@dataclass(frozen=True, eq=False)
class _Fold:
    """A fold: its rows, those of each of its blocks within it, and what the common set makes of them."""

    rows: NDArray[np.int_]
    blocks: tuple[NDArray[np.int_], ...]
    covariance: Array  # (P, P) of the parameters by the other rows
    mean: Array  # (P, D) of them
    over: tuple[Array, ...]  # of each block, the inverse of the root of its S
    white: tuple[Array, ...]  # (5 k, D) residuals over that root


class _Common:
    """The set that all candidates have, with the draws."""

    def __init__(self, common: Linear, fold: NDArray[np.int_], block: NDArray[np.int_], noise: Array) -> None:
        self.noise = noise * common.given.reshape(-1, 1)
        self.A = np.ascontiguousarray(common.J.reshape(-1, common.J.shape[2]))
        H, z = self.A.T @ self.A + np.diag(common.precision), self.A.T @ self.noise
        self.folds = [self._fold(H, z, block, np.flatnonzero(fold == number)) for number in np.unique(fold)]
        self.plain = np.zeros(noise.shape[1])
        for one in self.folds:
            for over, white in zip(one.over, one.white, strict=True):
                self.plain -= np.einsum("nd,nd->d", white, white) / 2 - np.log(np.diag(over)).sum()

    def _fold(self, H: Array, z: Array, block: NDArray[np.int_], left: NDArray[np.int_]) -> _Fold:
        rows = numbers(left)
        A, noise = self.A[rows], self.noise[rows]
        covariance = solved(H - A.T @ A, np.eye(len(H)))
        covariance = (covariance + covariance.T) / 2
        mean = covariance @ (z - A.T @ noise)
        moved = noise - A @ mean
        blocks = tuple(numbers(np.flatnonzero(block[left] == member)) for member in np.unique(block[left]))
        over = tuple(np.linalg.inv(np.linalg.cholesky(_predicted(A[own], covariance))) for own in blocks)
        white = tuple(root @ moved[own] for root, own in zip(over, blocks, strict=True))
        return _Fold(rows, blocks, covariance, mean, over, white)

    def scores(self, more: Linear) -> Array:
        """(D,) with columns besides."""
        if not more.J.shape[2]:
            return self.plain.copy()
        B = np.ascontiguousarray(more.J.reshape(-1, more.J.shape[2]))
        score = self.plain.copy()
        cross, square, z = self.A.T @ B, B.T @ B, B.T @ self.noise
        for one in self.folds:
            own = B[one.rows]
            by_common = cross - self.A[one.rows].T @ own
            slopes = one.covariance @ by_common
            precision = np.diag(more.precision) + square - own.T @ own - by_common.T @ slopes
            mean = solved(precision, z - own.T @ self.noise[one.rows] - by_common.T @ one.mean)
            beside = own - self.A[one.rows] @ slopes
            score -= _gone(one, beside, (precision + precision.T) / 2, mean)
        return score


def _gone(one: _Fold, beside: Array, precision: Array, mean: Array) -> Array:
    """(D,) half of what columns `beside` (5 f, c), their means (c, D) known, add to the loss of a fold's blocks."""
    W = [root @ beside[own] for root, own in zip(one.over, one.blocks, strict=True)]
    u = np.stack([w.T @ white for w, white in zip(W, one.white, strict=True)])
    V = np.stack([w.T @ w for w in W])
    moved = V @ mean
    left = u - moved
    roots = np.linalg.cholesky(precision + V)
    squares = ((np.linalg.inv(roots) @ left) ** 2).sum(axis=(0, 1))
    sizes = 2 * np.log(np.diagonal(roots, axis1=1, axis2=2)).sum()
    sizes -= len(W) * 2 * np.log(np.diag(np.linalg.cholesky(precision))).sum()
    gone: Array = ((mean * (moved - 2 * u)).sum(axis=(0, 1)) - squares + sizes) / 2
    return gone


def _predicted(A: Array, covariance: Array) -> Array:
    """(5 k, 5 k) covariance S of a block's residuals when its fold was left out."""
    S: Array = np.eye(len(A)) + A @ covariance @ A.T
    return (S + S.T) / 2


DRAWS = 400
ALARM_RATE = 0.02  # of pure noise that makes some candidate pass
LEAST_THRESHOLD = 3.0  # log-likelihood: what a single pair of odds of 20 to 1 weighs

Scores = Callable[[Sequence[Linear], Array], Sequence[Array]]


def white(count: int) -> Array:
    """(5 K, D) pure noise of `count` = 5 K numbers."""
    noise: Array = np.random.default_rng(SEED).standard_normal((count, DRAWS))
    return noise


def null_threshold(here: Linear, beside: Sequence[Linear], scores: Scores, draws: Array | None = None) -> float:
    """Gain in held-out log-likelihood that the best of all candidates exceeds in 2 % of draws (5 K, D) of noise.

    scores: of systems and draws, (D,) of each. Without any draws they are white.
    """
    return null_thresholds(here, beside, scores, [white(here.r.size) if draws is None else draws])[0]


def null_thresholds(here: Linear, beside: Sequence[Linear], scores: Scores, draws: Sequence[Array]) -> list[float]:
    """Thresholds for several kinds of draws (5 K, D) at once: what they share of every system is computed once."""
    noise = np.hstack(draws)
    plain, *others = scores([here, *beside], noise)
    best = np.max(others, axis=0) - plain
    ends = np.cumsum([one.shape[1] for one in draws])[:-1]
    return [max(LEAST_THRESHOLD, float(np.quantile(part, 1 - ALARM_RATE))) for part in np.split(best, ends)]
