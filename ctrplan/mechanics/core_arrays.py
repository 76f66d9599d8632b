"""What the compiled core takes and returns: joints, tubes and walks in, shapes out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.base.arguments import Number, require
from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import Bound, Bounds, Shape, Status, Tips
from ctrplan.mechanics.tube import RANGES, SECTION_RANGES, Tube
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits, PathSamples

if TYPE_CHECKING:
    from ctrplan.mechanics.guide import Guide
    from ctrplan.mechanics.tube import Loads

Table = TypeVar("Table", Bounds, PathSamples, Tips)
TipMemory = _model.TipMemory
Near = tuple[TipMemory, list[int]]  # solutions of robots that hardly differ, and the places of rows among them


def joint_row(values: ArrayLike, n: int, name: str = "joint array") -> Array:
    """The (n,) joint array in the layout of the core, of its own: the caller's may change. Raises InputError."""
    row = np.array(numbers(values, name), order="C")
    if row.shape != (n,):
        raise InputError(f"must have shape ({n},), one value per tube, not {row.shape}", key=name)
    return row


def joint_rows(theta_b: ArrayLike, l_b: ArrayLike, n: int) -> tuple[Array, Array]:
    """Base rotations and translations (K, n) in the layout of the core. Raises InputError."""
    rows = joint_table(theta_b, n, "theta_b"), joint_table(l_b, n, "l_b")
    if len(rows[0]) != len(rows[1]):
        raise InputError("theta_b and l_b need the same number of rows")
    return rows


def joint_table(values: ArrayLike, n: int, name: str = "joint array") -> Array:
    """A (K, n) joint array in the layout of the core. Raises InputError."""
    rows = np.ascontiguousarray(numbers(values, name))
    if rows.ndim != 2 or rows.shape[1] != n:
        raise InputError(f"must have shape (K, {n}), not {rows.shape}", key=name)
    return rows


def require_tubes(tubes: Sequence[Tube]) -> None:
    """Raises InputError for a number of a tube that is out of its range."""
    for i, tube in enumerate(tubes, start=1):
        _require(f"tube.{i}", tube, RANGES)
        for k, section in enumerate(tube.sections, start=1):
            _require(f"tube.{i}.section.{k}", section, SECTION_RANGES)
        if not 0 <= tube.inner_diameter_m < tube.outer_diameter_m:
            rule = f"must be from 0 to below the outer diameter of {tube.outer_diameter_m:g} m"
            raise InputError(rule, key=f"tube.{i}.inner_diameter_m", value=tube.inner_diameter_m, unit="m")


def _require(place: str, of: object, ranges: Mapping[str, Number]) -> None:
    for name, kind in ranges.items():
        require(f"{place}.{name}", getattr(of, name), kind)


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
            for section in tube.pieces
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


def core_model(
    tubes: Sequence[Tube], clearance_m: Array, friction: Array, loads: Loads, guide: Guide | None
) -> _model.Model:
    """The compiled model of tubes, pairs with clearances and friction coefficients (n - 1,), loads and a guide."""
    pairs = zip(clearance_m.tolist(), friction.tolist(), tubes[:-1], tubes[1:], strict=True)
    return _model.Model(
        [core_tube(tube) for tube in tubes], [core_pair(*pair) for pair in pairs], core_loads(loads), core_guide(guide)
    )


def core_guide(guide: Guide | None) -> tuple[Array, Array, Array, Array] | None:
    """The shapes of a branch as the core reads them; None of the one that a robot without precurvature leads to."""
    if guide is None:
        return None
    s_m, theta_b, l_b, angles = map(np.ascontiguousarray, (guide.s_m, guide.theta_b, guide.l_b, guide.angles_rad))
    return s_m, theta_b, l_b, angles


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
        between_corners=density.between_corners,
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
