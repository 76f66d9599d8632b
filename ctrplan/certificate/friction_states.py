"""Friction states: points phi of the cube [-1, 1]^P, one number per pair of tubes; and allowances for what was
measured.

Where intervals or play of a robot are large, their axes are further ones of the cube.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import Accuracy

if TYPE_CHECKING:
    from ctrplan.mechanics.walk import PathSamples
    from ctrplan.robot.robot import Robot

SPACING_M = 0.5e-3  # largest motion of a body point of any shape between samples
POINT_SPACING_M = 1e-3  # between the points of a shape
LOOK_EVERY = 4  # samples, between which what changes slowly along the path is taken from those on both sides
# Friction that differs along the contact of a pair: bodies of simulated histories were at most 0.05 mm beyond those of
# all uniform states (1,632 histories, but for a fold, which is a snap).
UNEVEN_FRICTION_M = 0.05e-3
TIGHT_M = 0.1e-3  # how much less than the clearance of solved shapes is reported where nothing was found below it
# Of bodies that were not solved but interpolated along the path: shares of how much their bending away from the sign
# corners changes over the samples, of that bending, and once more of it from one mesh to another.
BEND_CHANGE, BEND_SHARE, BEND_MESH, BEND_SPREAD = 0.5, 0.05, 0.2, 0.03
BEYOND_BOUND_M = 0.3e-3  # of a simulated tip: histories and bounds may be of different meshes

# Of bodies, against the model of exact geometry: 0.27 mm at most on the search mesh, 0.17 on the certificate mesh, for
# clearances between tubes below 0.1 mm. Wide ones add to it, for the model is of first order in them: 0.44 mm for each
# mm of all pairs together at most (`benchmarks/run.py allowances`). Exact geometry on the certificate mesh is within
# 0.09 mm of one of three times as many elements where friction is full, but for one of 360 states, of which that is no
# nearer to a still finer one; without friction within 0.02.
CERTIFICATE_MESH_M, SEARCH_MESH_M = 0.2e-3, 0.8e-3  # the latter on top of the former
EXACT_MESH_M = 0.1e-3
NARROW_M, FIRST_ORDER = 0.05e-3, 0.4
# Of bounds, which are differences of tips on one mesh: 0.23 mm short at most on the search mesh, 0.007 on the
# certificate mesh, and 0.08 for each mm of clearance.
BOUND_CERTIFICATE_MESH_M, BOUND_SEARCH_MESH_M, BOUND_FIRST_ORDER = 0.02e-3, 0.3e-3, 0.1


def signed_square(stability: Array) -> Array:
    """Squares of stabilities, any shape, with the stabilities' signs.

    Near a fold they are linear in parameters, as the stability, their root, is not.
    """
    return np.asarray(np.sign(stability) * stability**2)


def tips_at(walks: Sequence[PathSamples], row: int) -> Array:
    """(T, 3) [m] tips of every shape of the walks at a row."""
    return np.vstack([tips for walk in walks for tips in (walk.tip_m[row], walk.corner_tip_m[row])])


def mesh_allowance_m(robot: Robot, accuracy: Accuracy) -> float:
    """How far [m] a body point may be from where the model of exact geometry has it."""
    if accuracy == "exact":
        return EXACT_MESH_M
    loose = NARROW_M + FIRST_ORDER * float(robot.clearance_m.sum())
    return max(CERTIFICATE_MESH_M, loose) + (SEARCH_MESH_M if accuracy == "search" else 0.0)


def exact_gives_back_m(robot: Robot) -> float:
    """How much more [m] is left of a clearance of the certificate mesh once it is solved with exact geometry."""
    return mesh_allowance_m(robot, "certificate") - mesh_allowance_m(robot, "exact")


def bound_allowance_m(robot: Robot, accuracy: Accuracy) -> float:
    """How much [m] a bound of the tip may be short of the one of exact geometry; 0 without friction."""
    if not robot.friction.any():
        return 0.0
    loose = BOUND_FIRST_ORDER * float(robot.clearance_m.sum())
    return BOUND_CERTIFICATE_MESH_M + loose + (BOUND_SEARCH_MESH_M if accuracy == "search" else 0.0)


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
    """A configuration without friction and in the corners of its cube, in the order of `corner_states`."""

    bodies_m: Array  # (1 + C, N, 3)
    stability: Array  # (1 + C,)
    max_strain: Array  # (1 + C,)
    radius_m: Array  # (N,) of what the body fills

    @property
    def pairs(self) -> int:
        """Number of axes of the cube."""
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

    def halves(self, axes: Collection[int] | None = None) -> list[Cell]:
        """The 2^P parts of the cell, or two halves along each of some axes."""
        ends = list(zip(self.low, self.middle, self.high, strict=True))
        whole = range(len(ends)) if axes is None else axes
        parts = itertools.product(*(((a, m), (m, b)) if k in whole else ((a, b),) for k, (a, m, b) in enumerate(ends)))
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
