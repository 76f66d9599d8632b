"""Walking a path through the mechanics: how densely, until what, and what is found on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError

SHORTEST_STEP = 1e-6  # rad or m


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
    bodies: tuple[Array, ...] = ()  # per sample, if asked for: (N, 4) points of all shapes and their outer radius [m]


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

    def __post_init__(self) -> None:
        """Raises InputError for steps so short that a walk would not end."""
        for key, value in vars(self).items():
            if not value >= SHORTEST_STEP:
                unit = "rad" if key == "rotation_rad" else "m"
                raise InputError(f"must be at least {SHORTEST_STEP:g} {unit}", key=key, value=value, unit=unit)


@dataclass(frozen=True)
class PathLimits:
    """A walk ends at the first sample that breaks one of these."""

    stability: float = -np.inf
    max_strain: float = np.inf
    clearance_m: float = -np.inf

    def __post_init__(self) -> None:
        """Raises InputError for NaN, which no sample would break."""
        for key, value in vars(self).items():
            if np.isnan(value):
                raise InputError("must be a number", key=key, value=value)


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
            try:
                values = np.ascontiguousarray(getattr(self, key), dtype=kind)
            except (TypeError, ValueError):
                raise InputError("must be numbers", key=f"field.{key}") from None
            fits = values.ndim == len(shape) and all(b in (None, a) for a, b in zip(values.shape, shape, strict=True))
            if not fits or values.size == 0:
                wanted = "(nx, ny, nz)" if shape[0] is None else str(shape)
                raise InputError(f"must have shape {wanted}, not {values.shape}", key=f"field.{key}")
            if kind is np.float64 and not np.all(np.isfinite(values)):
                raise InputError("must be finite", key=f"field.{key}")
            object.__setattr__(self, key, values)
        if not (np.isfinite(self.spacing_m) and self.spacing_m > 0):
            raise InputError("must be above 0", key="field.spacing_m", value=self.spacing_m)
