"""Friction states: points phi of the cube [-1, 1]^P, one number per pair of tubes; its corners and cells."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from ctrplan.base.arrays import Array

State = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Solved:
    """A robot in one friction state."""

    body_m: Array  # (N, 3) NaN, all of it, where no equilibrium was found
    stability: float
    max_strain: float
    doubt_m: Array | None = None  # (N,) what the body may be off by where it was not solved itself

    @property
    def has_body(self) -> bool:
        """Whether an equilibrium was found."""
        return math.isfinite(self.body_m[-1, 0])


@dataclass(frozen=True, eq=False)
class CornerShapes:
    """A configuration without friction and in its sign corners, in the order of `corner_states`."""

    bodies_m: Array  # (1 + C, N, 3)
    stability: Array  # (1 + C,)
    max_strain: Array  # (1 + C,)
    radius_m: Array  # (N,) outer radii

    @property
    def pairs(self) -> int:
        """Of tubes."""
        return len(self.bodies_m).bit_length() - 1

    @cached_property
    def solved(self) -> dict[State, Solved]:
        """By friction state."""
        states = [(0.0,) * self.pairs, *corner_states(self.pairs)]
        rows = zip(self.bodies_m, self.stability.tolist(), self.max_strain.tolist(), strict=True)
        return {state: Solved(*row) for state, row in zip(states, rows, strict=True)}


@dataclass(frozen=True)
class Cell:
    """A box of friction states, halved `depth` times from the cube."""

    low: State
    high: State
    depth: int

    @cached_property
    def middle(self) -> State:
        """Halfway between both ends."""
        return tuple((a + b) / 2 for a, b in zip(self.low, self.high, strict=True))

    @property
    def corners(self) -> list[State]:
        """The last pair fastest, low before high."""
        return list(itertools.product(*zip(self.low, self.high, strict=True)))

    def at(self, unit: Array) -> State:
        """The state at shares (P,), 0 to 1, of the way from low to high."""
        low, high = np.array(self.low), np.array(self.high)
        return tuple((low + unit * (high - low)).tolist())

    def halves(self) -> list[Cell]:
        """Its 2^P parts."""
        ends = list(zip(self.low, self.middle, self.high, strict=True))
        parts = itertools.product(*(((a, m), (m, b)) for a, m, b in ends))
        return [Cell(tuple(p[0] for p in part), tuple(p[1] for p in part), self.depth + 1) for part in parts]


@cache
def corner_states(pairs: int) -> Sequence[State]:
    """Friction states of the sign corners in the order of `Bound.corners`."""
    return tuple(itertools.product((1.0, -1.0), repeat=pairs))


def corner_weights(phi: Array) -> Array:
    """(S, 2^P) multilinear weights of the sign corners, in the order of `corner_states`, at states (S, P)."""
    signs = np.array(corner_states(phi.shape[1]))
    weights: Array = np.prod((1 + phi[:, None] * signs) / 2, axis=2)
    return weights
