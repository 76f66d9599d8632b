"""Derivatives of markers on the body by the parameters, by differences of whole solves: the core has those of tips."""

from __future__ import annotations

from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.remembered_slopes import remembered
from ctrplan.pipeline.term import Term

COARSE_STEP = 0.005  # of a parameter's prior, where the mechanics are differenced


class Differenced(Protocol):
    """A chain of markers' poses alone."""

    terms: tuple[Term, ...]
    prior: Array
    lower: Array
    upper: Array

    def stages(self) -> dict[str, list[int]]:
        """Per stage, positions of its parameters in the vector."""

    def before_sensor(self, p: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Where the points (K, 3) [m] are at parameters (P,), and whether (K,) that is an equilibrium."""


def marker_columns(chain: Differenced, data: Measurements, p: Array, here_m: Array, by: Array) -> Array:
    """(K, 3, P) of markers that are at (K, 3) [m], those of the sensor as they are; `data` remember slopes."""
    places, found = chain.stages(), by.copy()
    names = [(t.key, q.name) for t in chain.terms for q in t.parameters]
    for j in (*places["clock"], *places["drive"], *places["mechanics"]):
        column = partial(_differenced, chain, p, j, here_m)
        found[:, :, j] = remembered(data, names[j], here_m, float(p[j]), float(chain.prior[j]), column)
    return found


def _differenced(chain: Differenced, p: Array, j: int, here_m: Array) -> Array:
    """(K, 3) by parameter j, before plate and sensor."""
    by, left = np.zeros((len(here_m), 3)), np.ones(len(here_m), bool)
    for h in COARSE_STEP * chain.prior[j] * np.array([1.0, -1.0]):  # one way, or the other where it is barred
        moved = p.copy()
        moved[j] += h
        if left.any() and chain.lower[j] <= moved[j] <= chain.upper[j]:
            there, open_way = chain.before_sensor(moved)
            by[left] = ((there - here_m) / h)[left]
            left = left & ~open_way
    return by
