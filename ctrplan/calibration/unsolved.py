"""Poses at which a model has no solution: which are left out, and what is said of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.experiment.measurements import Measurements

MOST_FAILED = 1 / 3  # of the poses; a model without a solution at more of them explains nothing


def excused(failed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(K,) poses without a solution that are left out of chi-squares and errors: all, unless they are too many."""
    return failed if failed.mean() <= MOST_FAILED else np.zeros_like(failed)


def unsolved_sentence(
    data: Measurements, failed: NDArray[np.bool_], counted: NDArray[np.bool_], models: str
) -> list[str]:
    """About the poses (K,) at which a model failed, if any; `counted` are those that chi-squares and errors count."""
    if not failed.any():
        return []
    kept = int((failed & counted).sum())
    which = f"{kept} of them, too many to be left out, count as wrong" if kept else "they are left out"
    where = f"{failed.sum()} of {data.count} poses, {models} (row {data.rows_in_words(failed)})"
    return [f"The solver found no equilibrium at {where}: in chi-squares and errors {which}."]
