"""Which poses choose the model, and which nothing reads until the end: by configuration, never single approaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.experiment.measurements import Measurements

VAULT_SHARE = 0.25
FOLDS = 6
BLOCK_POSES = 10  # of a continuous motion: neighbours are not independent evidence
SEED = 20190417  # the split depends on the data's order alone


@dataclass(frozen=True, eq=False)
class Split:
    """Numbers of poses, and which fold of the cross-validation each of the selection belongs to."""

    selection: NDArray[np.int_]  # (S,)
    held_out_set: NDArray[np.int_]  # (V,)
    fold: NDArray[np.int_]  # (S,)


def groups(data: Measurements) -> NDArray[np.int_]:
    """(K,) poses that stand or fall together: configurations, or blocks of a continuous motion."""
    if data.is_stream:
        return np.unique(data.rows, return_inverse=True)[1].ravel() // BLOCK_POSES
    return data.configuration


def split(data: Measurements, usable: NDArray[np.bool_]) -> Split:
    """A quarter of the configurations for the held-out set, folds of whole configurations from the rest."""
    group = groups(data)
    numbers = np.random.default_rng(SEED).permutation(np.unique(group[usable]))
    sealed = int(round(VAULT_SHARE * len(numbers)))
    held_out = np.isin(group, numbers[:sealed]) & usable
    selection = np.flatnonzero(usable & ~held_out)
    order = {number: k % FOLDS for k, number in enumerate(numbers[sealed:].tolist())}
    fold = np.array([order[number] for number in group[selection].tolist()])
    return Split(selection, np.flatnonzero(held_out), fold)
