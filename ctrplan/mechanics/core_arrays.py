"""What the compiled core takes and returns: joints, tubes, walks and derivatives in, shapes out.

"tube.2.poisson_ratio", "contact.1.friction_coefficient", "l_b.3": keys of the robot file and joints, tubes and
contacts from 1, outermost first, values in SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import Bound, Bounds, Shape, Status, Tips
from ctrplan.mechanics.tube import Tube
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits, PathSamples

if TYPE_CHECKING:
    from ctrplan.mechanics.tube import Loads

Direction = tuple[list[int], list[float], float]  # numbers of the core, derivatives by the parameter, step

STEPS = {  # small against what the number usually is; differences across it are exact to about its square
    "softening_strain": 1e-8,
    "length": 1e-9,
    "l_b": 1e-9,
    "clearance": 1e-11,  # against the gap that is left in contact
    "tip_moment": 1e-6,
    "gravity": 1e-3,
}
DIRECT = {  # keys that are a number of the core as they stand
    "curvature_x_per_m": "curvature_x",
    "curvature_y_per_m": "curvature_y",
    "length_m": "length",
    "gradient": "gradient",
    "ovality": "ovality",
    "ovality_axis_rad": "ovality_axis",
    "softening_strain": "softening_strain",
    "softening_fraction": "softening_fraction",
    "shaft_compliance_rad_per_Nm": "shaft_compliance",
    "clearance_m": "clearance",
    "friction_coefficient": "friction",
    "tip_force_N": "tip_force",
    "tip_moment_Nm": "tip_moment",
    "gravity_m_s2": "gravity",
}


def directions(names: Sequence[str], tubes: Sequence[Tube], numbers: Sequence[str]) -> list[Direction]:
    """For each name its direction in the core's numbers. Raises InputError for a name that does not exist."""
    index = {number: k for k, number in enumerate(numbers)}
    return [_direction(name, tubes, index) for name in names]


def _direction(name: str, tubes: Sequence[Tube], index: dict[str, int]) -> Direction:
    parts = name.split(".")
    kind = parts[0]
    tube = _tube(parts, tubes, name) if kind == "tube" else None
    if tube is not None and parts[2:] == ["bending_stiffness_Nm2"]:  # at constant Poisson's ratio
        weights = {f"{kind}.{parts[1]}.bending_stiffness": 1.0}
        weights[f"{kind}.{parts[1]}.torsional_stiffness"] = 1 / (1 + tube.poisson_ratio)
        step = 1e-6 * tube.bending_stiffness_Nm2
    elif tube is not None and parts[2:] == ["poisson_ratio"]:
        slope = -tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio) ** 2
        weights, step = {f"tube.{parts[1]}.torsional_stiffness": slope}, 1e-6
    elif tube is not None and parts[2:] == ["density_kg_m3"]:
        area = math.pi / 4 * (tube.outer_diameter_m**2 - tube.inner_diameter_m**2)
        weights, step = {f"tube.{parts[1]}.mass_per_length": area}, 1.0
    else:
        number = ".".join("pair" if part == "contact" else DIRECT.get(part, part) for part in parts)
        weights, step = {number: 1.0}, _step(number)
    missing = [number for number in weights if number not in index]
    if missing:
        raise InputError("is not a parameter of this robot", key=name)
    return [index[number] for number in weights], list(weights.values()), step


def _tube(parts: list[str], tubes: Sequence[Tube], name: str) -> Tube:
    if len(parts) < 3 or not parts[1].isdecimal() or not 1 <= int(parts[1]) <= len(tubes):
        raise InputError("is not a parameter of this robot", key=name)
    return tubes[int(parts[1]) - 1]


def _step(number: str) -> float:
    for part in number.split("."):
        if part in STEPS:
            return STEPS[part]
    return 1e-5


Table = TypeVar("Table", Bounds, PathSamples, Tips)


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


def core_tube(tube: Tube) -> _model.Tube:
    """A tube as the core reads it: radii, stiffnesses, and what the effects add."""
    return _model.Tube(
        outer_radius=tube.outer_diameter_m / 2,
        inner_radius=tube.inner_diameter_m / 2,
        bending_stiffness=tube.bending_stiffness_Nm2,
        torsional_stiffness=tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio),
        collar_length=tube.collar_length_m,
        sections=[
            _model.Section(
                length=section.length_m,
                curvature_x=section.curvature_x_per_m,
                curvature_y=section.curvature_y_per_m,
                gradient=section.gradient,
            )
            for section in tube.sections
        ],
        ovality=tube.ovality,
        ovality_axis=tube.ovality_axis_rad,
        softening_strain=min(tube.softening_strain, 1e300),
        softening_fraction=tube.softening_fraction,
        shaft_compliance=tube.shaft_compliance_rad_per_Nm,
        mass_per_length=tube.mass_per_length_kg_m,
        retractable=tube.retractable,
    )


def core_pair(clearance_m: float, friction: float, outer: Tube, inner: Tube) -> _model.Pair:
    """Two neighbouring tubes as the core reads what is between them."""
    return _model.Pair(
        clearance=clearance_m,
        friction=friction,
        outer_inner_radius=outer.inner_diameter_m / 2,
        inner_outer_radius=inner.outer_diameter_m / 2,
    )


def core_loads(loads: Loads) -> _model.Loads:
    """Loads as the core reads them."""
    return _model.Loads(tip_force=loads.tip_force_N, tip_moment=loads.tip_moment_Nm, gravity=loads.gravity_m_s2)


def core_grid(field: Field | None) -> _model.Grid | None:
    """A grid of clearances as the core reads it; None is free space."""
    if field is None:
        return None
    return _model.Grid(
        values=field.values_m, origin=field.origin_m, spacing=field.spacing_m, R_AB=field.R_AB, p_AB=field.p_AB
    )


def core_density(density: PathDensity) -> _model.PathDensity:
    """How densely a path is walked, as the core reads it."""
    return _model.PathDensity(
        rotation=density.rotation_rad,
        translation=density.translation_m,
        motion=density.motion_m,
        near=density.near_m,
        point_spacing=density.point_spacing_m,
    )


def core_limits(limits: PathLimits) -> _model.PathLimits:
    """Until what a path is walked, as the core reads it."""
    return _model.PathLimits(stability=limits.stability, max_strain=limits.max_strain, clearance=limits.clearance_m)


def worst(values: Array) -> float:
    """The value that is none, or else the largest by size, for a message."""
    return float(np.ravel(values)[np.argmax(np.where(np.isnan(values), np.inf, np.abs(values)))])


def sound(status: NDArray[np.int_], *numbers: Array) -> NDArray[np.int_]:
    """Status (K,), FAILED wherever one of the numbers (K,) or (K, d), which a solution must have, is not finite."""
    finite = np.isfinite(np.column_stack(numbers)).all(axis=1)
    return np.where(finite, status, int(Status.FAILED))


def promised(table: Table) -> Table:
    """The table, FAILED wherever a number that a solution must have is not finite. Bounds are of several solutions."""
    names: tuple[str, ...] = ("tip_m", "tip_tangent", "stability")
    if isinstance(table, Tips):
        names = ("position_m", "tangent")
    columns = (getattr(table, name) for name in (*names, "max_strain"))
    return replace(table, status=sound(table.status, *columns))


def solved_shape(raw: Any) -> Shape:
    """The Shape of what a solve of the core returns, a _model.Shape; FAILED where it has no stability."""
    is_known = raw.status == Status.OVERTWISTED or (raw.is_finite and isfinite(raw.stability))
    return Shape.of_core(raw, Status(raw.status) if is_known else Status.FAILED)


def solved_bound(raw: dict[str, Any]) -> Bound:
    """The Bound of what the core returns."""
    corners = tuple(map(solved_shape, raw["corners"]))
    return Bound(**raw | {"frictionless": solved_shape(raw["frictionless"]), "corners": corners})


def shape_from_core(raw: Any) -> Shape:
    """The Shape of what the core returns, a _model.Shape; histories do not know the stability."""
    return Shape.of_core(raw, Status(raw.status) if raw.is_finite else Status.FAILED)
