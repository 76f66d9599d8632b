"""What the core takes and returns, as arrays: joints, tubes and walks in; shapes, bounds and samples out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import Bounds, Shape, Status, TubeShape
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits, PathSamples

if TYPE_CHECKING:
    from ctrplan.mechanics.tube import Tube

FREE_SPACE = Field(np.zeros((1, 1, 1), np.float32), np.zeros(3), 1.0, np.eye(3), np.zeros(3))  # where there is none


def joint_row(values: ArrayLike, n: int) -> Array:
    """The (n,) joint array in the layout of the core, of its own: the caller's may change. Raises InputError."""
    row = np.array(numbers(values, "joint array"), order="C")
    if row.shape != (n,):
        raise InputError(f"must have shape ({n},), one value per tube, not {row.shape}", key="joint array")
    return row


def joint_rows(theta_b: ArrayLike, l_b: ArrayLike, n: int) -> tuple[Array, Array]:
    """Base rotations and translations (K, n) in the layout of the core. Raises InputError."""
    rows = joint_table(theta_b, n), joint_table(l_b, n)
    if len(rows[0]) != len(rows[1]):
        raise InputError("theta_b and l_b need the same number of rows")
    return rows


def joint_table(values: ArrayLike, n: int) -> Array:
    """A (K, n) joint array in the layout of the core. Raises InputError."""
    rows = np.ascontiguousarray(numbers(values, "joint array"))
    if rows.ndim != 2 or rows.shape[1] != n:
        raise InputError(f"must have shape (K, {n}), not {rows.shape}", key="joint array")
    return rows


def tube_numbers(tube: Tube) -> list[float]:
    """A tube as the core reads it, in SI units: radii, stiffnesses, and what the effects add."""
    return [
        tube.outer_diameter_m / 2,
        tube.inner_diameter_m / 2,
        tube.bending_stiffness_Nm2,
        tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio),
        tube.collar_length_m,
        tube.ovality,
        tube.ovality_axis_rad,
        min(tube.softening_strain, 1e300),
        tube.softening_fraction,
        tube.shaft_compliance_rad_per_Nm,
        tube.mass_per_length_kg_m,
    ]


def numbers(values: ArrayLike, key: str) -> Array:
    """Whatever is given as floats. Raises InputError."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("must be numbers", key=key) from None


def walk_arguments(
    field: Field | None, density: PathDensity, limits: PathLimits
) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
    """What the core is told of a walk, in its order."""
    grid = field or FREE_SPACE
    return (
        None if field is None else grid.values_m,
        grid.origin_m,
        grid.spacing_m,
        grid.R_AB,
        grid.p_AB,
        np.array(
            [density.rotation_rad, density.translation_m, density.motion_m, density.near_m, density.point_spacing_m]
        ),
        np.array([limits.stability, limits.max_strain, limits.clearance_m]),
    )


def path_samples(table: Array, bodies: Sequence[Array]) -> PathSamples:
    """Names for the columns of the core's table of samples."""
    return PathSamples(
        segment=table[:, 0].astype(int),
        fraction=table[:, 1],
        position_m=table[:, 2],
        tangent_rad=table[:, 3],
        stability=table[:, 4],
        max_strain=table[:, 5],
        clearance_m=table[:, 6],
        motion_m=table[:, 7],
        status=table[:, 8].astype(int),
        tip_m=table[:, 9:12],
        tip_tangent=table[:, 12:15],
        solves=table[:, 15].astype(int),
        corner_tip_m=table[:, 16:].reshape(len(table), (table.shape[1] - 16) // 3, 3),
        bodies=tuple(bodies),
    )


def worst(values: Array) -> float:
    """The value that is none, or else the largest by size, for a message."""
    return float(np.ravel(values)[np.argmax(np.where(np.isnan(values), np.inf, np.abs(values)))])


def bounds_from_core(table: Array) -> Bounds:
    """Names for the columns of the core's table of bounds."""
    return Bounds(
        position_m=table[:, 0],
        tangent_rad=table[:, 1],
        stability=table[:, 2],
        max_strain=table[:, 3],
        residual=table[:, 4],
        status=table[:, 5].astype(int),
        tip_m=table[:, 6:9],
        tip_tangent=table[:, 9:12],
    )


def shape_from_core(raw: dict[str, Any]) -> Shape:
    """The Shape of what the core returns."""
    contacts = raw["contacts"]
    return Shape(
        tubes=tuple(TubeShape(*tube) for tube in raw["tubes"]),
        radius_m=raw["radius"],
        contact_s_m=tuple(contact[0] for contact in contacts),
        contact_force_N=tuple(contact[1] for contact in contacts),
        contact_angle_rad=tuple(contact[2] for contact in contacts),
        status=Status(raw["status"]),
        residual=raw["residual"],
        stability=raw["stability"],
        max_strain=raw["max_strain"],
    )
