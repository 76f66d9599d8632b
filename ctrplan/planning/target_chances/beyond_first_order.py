"""What solves of the first draws differ by from first order, for all draws: a quadratic in the parameters, and a rest.

The quadratic is fitted to the solves, with ridge, for parameters may be correlated. Where there are too many parameters
for all its terms, products of two are left out. What it does not explain is given to the draws in turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array

RIDGE = 1.0  # beside sums of squares of as many as there are solves
SHARE = 0.5  # of the solves, as many terms at most


@dataclass(frozen=True, eq=False)
class BeyondFirstOrder:
    """Of R solves."""

    weight: Array  # (F, ...) of the quadratic's terms
    rest: Array  # (R, ...) NaN where there was no equilibrium

    @classmethod
    def of(cls, deviations: Array, found: Array) -> BeyondFirstOrder:
        """Of differences found (R, ...) of draws, deviations (R, P) from their values in standard deviations."""
        flat, terms = found.reshape(len(found), -1), _terms(deviations, len(found))
        known = ~np.isnan(flat).any(axis=1)
        A, values = terms[known], flat[known]
        if len(A) * SHARE < A.shape[1]:
            return cls(np.zeros((A.shape[1], *found.shape[1:])), found)
        solved = np.linalg.solve(A.T @ A + RIDGE * np.eye(A.shape[1]), A.T @ values)
        weight = np.asarray(solved, dtype=np.float64).reshape(-1, *found.shape[1:])
        return cls(weight, found - np.tensordot(terms, weight, axes=1))

    def at(self, deviations: Array, place: int) -> Array:
        """(M, ...) of draws (M, P), the first R those solved, at one place of the first axis after the draws."""
        quadratic = np.tensordot(_terms(deviations, len(self.rest)), self.weight[:, place], axes=1)
        found: Array = quadratic + repeated(self.rest[:, place], len(deviations))
        return found


def repeated(values: Array, count: int) -> Array:
    """(count, ...) values (R, ...) over and over."""
    found: Array = np.take(values, np.arange(count), axis=0, mode="wrap")
    return found


def _terms(deviations: Array, solves: int) -> Array:
    """(M, F) one, linear terms, squares, and products of two unless they are too many."""
    count, P = deviations.shape
    columns = [np.ones((count, 1)), deviations, deviations**2]
    if SHARE * solves >= 1 + 2 * P + P * (P - 1) // 2:
        i, j = np.triu_indices(P, 1)
        columns.append(deviations[:, i] * deviations[:, j])
    return np.concatenate(columns, axis=1)
