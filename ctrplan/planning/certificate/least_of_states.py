"""What is asked of all friction states of a configuration, and what is known of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.certificate.friction_states import State


@dataclass(frozen=True)
class Needed:
    """What every friction state has to keep; no cell is halved to know more."""

    clearance_m: float
    stability: float = -np.inf
    max_strain: float = np.inf


@dataclass(frozen=True, eq=False)
class LeastOfStates:
    """What is known of all states: if it is what was asked for, none has less; else what one may have."""

    clearance_m: float  # -inf where a state has no equilibrium
    stability: float
    max_strain: float
    phi: State  # where the least clearance was found, solved or interpolated
    point_m: Array  # (3,) the body's point there, robot frame
    solves: int  # states solved besides those that were known

    def with_less_of(self, other: LeastOfStates) -> LeastOfStates:
        """The worse of both in each respect."""
        nearer = other if other.clearance_m < self.clearance_m else self
        return LeastOfStates(
            nearer.clearance_m,
            min(self.stability, other.stability),
            max(self.max_strain, other.max_strain),
            nearer.phi,
            nearer.point_m,
            self.solves + other.solves,
        )

    def keeps(self, needed: Needed) -> bool:
        """Whether nothing less than needed is left."""
        return (
            self.clearance_m >= needed.clearance_m
            and self.stability >= needed.stability
            and self.max_strain <= needed.max_strain
        )
