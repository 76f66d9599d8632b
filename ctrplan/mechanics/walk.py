"""Walking a path through the mechanics: how densely, until what, and what is found on the way."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import Number, checked, require
from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError

SHORTEST_STEP, LONGEST_STEP = 1e-6, 100.0  # rad or m; with shorter ones a walk would not end
ANY = Number(-np.inf, np.inf)


def no_shapes() -> Array:
    """(0, 0) of a walk that keeps no shapes."""
    return np.empty((0, 0))


@dataclass(frozen=True, eq=False)
class PathSamples:
    """What `Mechanics.check_path` found at each of the K configurations it reached."""

    segment: NDArray[np.int_]  # (K,) leg the sample lies on
    fraction: Array  # (K,) of that leg
    position_m: Array  # (K,) bound of the tip
    tangent_rad: Array  # (K,)
    stability: Array  # (K,)
    max_strain: Array  # (K,)
    clearance_m: Array  # (K,) smallest over frictionless and corner shapes, outer radius taken off; 1e9 in free space
    motion_m: Array  # (K,) largest displacement of a body point of any of these shapes since the sample before
    status: NDArray[np.int_]  # (K,) values of Status
    tip_m: Array  # (K, 3) frictionless
    tip_tangent: Array  # (K, 3)
    solves: NDArray[np.int_]  # (K,) configurations solved since the sample before, those not accepted among them
    corner_tip_m: Array  # (K, C, 3) of the corner shapes in the order of Bound.corners; C = 0 when looked up
    # Of every shape, frictionless first, if asked for:
    shape_stability: Array = field(default_factory=no_shapes)  # (K, 1 + C) friction included
    shape_max_strain: Array = field(default_factory=no_shapes)  # (K, 1 + C)
    bodies: tuple[Array, ...] = ()  # per sample: (N, 4) points of all shapes and their outer radius [m]


@checked(
    rotation_rad=Number(SHORTEST_STEP, LONGEST_STEP, "rad"),
    translation_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
    motion_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
    near_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
    point_spacing_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
)
@dataclass(frozen=True)
class PathDensity:
    """How densely a path is walked: longest joint steps, largest motion of a body point between samples.

    Where `near_m` is below `motion_m`, a step may move a body point no farther than the clearance it starts with, or
    `near_m`: clearances are 1-Lipschitz, so that an obstacle is noticed before it is passed.
    """

    rotation_rad: float = 0.18
    translation_m: float = 5e-3
    motion_m: float = 20e-3
    near_m: float = 2e-3
    point_spacing_m: float = 1.5e-3  # between the points of a shape that are looked up in the field


@checked(stability=ANY, max_strain=ANY, clearance_m=ANY)
@dataclass(frozen=True)
class PathLimits:
    """A walk ends at the first sample that breaks one of these."""

    stability: float = -np.inf
    max_strain: float = np.inf
    clearance_m: float = -np.inf


@dataclass(frozen=True, eq=False)
class Field:
    """A grid of clearances [m] in the anatomy's frame A, and where the robot's base B stands in it."""

    values_m: NDArray[np.float32]  # (nx, ny, nz)
    origin_m: Array  # (3,)
    spacing_m: float
    R_AB: Array  # (3, 3)
    p_AB: Array  # (3,)

    def __post_init__(self) -> None:
        """Takes what can be read as such arrays. Raises InputError for other shapes, or numbers that say nothing."""
        for key, shape, kind in (
            ("values_m", (None,) * 3, np.float32),
            ("origin_m", (3,), np.float64),
            ("R_AB", (3, 3), np.float64),
            ("p_AB", (3,), np.float64),
        ):
            values = getattr(self, key)
            if not isinstance(values, np.ndarray) or values.dtype != kind:  # large grids are not copied
                values = numbers(values, f"field.{key}").astype(kind)
            values = np.ascontiguousarray(values)
            fits = values.ndim == len(shape) and all(b in (None, a) for a, b in zip(values.shape, shape, strict=True))
            if not fits or values.size == 0:
                wanted = "(nx, ny, nz)" if shape[0] is None else str(shape)
                raise InputError(f"must have shape {wanted}, not {values.shape}", key=f"field.{key}")
            if kind is np.float64 and not np.all(np.isfinite(values)):
                raise InputError("must be finite", key=f"field.{key}")
            object.__setattr__(self, key, values)
        require("field.spacing_m", self.spacing_m, Number(0, 1e3, "m", above=True))
