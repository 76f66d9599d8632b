"""Scores of pure noise of many sets of parameters that have most of them in common, as `predictive` defines them.

Chance is asked of hundreds of candidates beside one set. What that set makes of draws and blocks is found once, with
columns A; a candidate adds columns B. Of a block b whose fold is left out, with C the covariance of the set's own
parameters by the other rows R,

    B' = B_b - A_b C A_R^T B_R    precision of B's parameters  P = prior + B_R^T B_R - B_R^T A_R C A_R^T B_R

and the block's residuals over the root of its own S have the covariance I + W P^-1 W^T, W = B' over that root. So a
candidate costs in proportion to its own columns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.held_out import Linear, solved
from ctrplan.diagnosis.predictive import numbers, predictive_null_scores

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
    found = []
    for system, mine in zip(systems, columns, strict=True):
        alike = len(mine) == len(set(mine)) and shared <= set(mine) and np.array_equal(system.given, common.given)
        own = [k for k, column in enumerate(mine) if column not in shared]
        found.append(
            beside.scores(system.columns(own)) if alike else predictive_null_scores(system, fold, block, noise)
        )
    return found


def _columns(system: Linear) -> list[bytes]:
    """What makes a parameter the same one in two systems: its derivatives and its prior."""
    J = np.ascontiguousarray(np.moveaxis(system.J, 2, 0))
    return [J[k].tobytes() + system.precision[k].tobytes() for k in range(len(J))]


@dataclass(frozen=True, eq=False)
class _Fold:
    """Of a fold: its rows, those of each of its blocks within it, and what the common set makes of them."""

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
