"""Precurved tubes and the contacts between neighbours, outermost first."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ctrplan.base.arguments import Number
from ctrplan.errors import InputError

SOFTEST_NM2, STIFFEST_NM2 = 1e-9, 1e6

# What the core is told of a tube; files have narrower ranges in their own units. Fits go beyond what files may say.
RANGES = {
    "outer_diameter_m": Number(0, 1, "m", above=True),
    "inner_diameter_m": Number(0, 1, "m"),
    "bending_stiffness_Nm2": Number(SOFTEST_NM2, STIFFEST_NM2, "N m^2"),
    "poisson_ratio": Number(-1, 10, above=True),
    "collar_length_m": Number(0, 5, "m"),
    "max_strain": Number(0, 1),
    "density_kg_m3": Number(0, 1e5, "kg/m^3"),
    "ovality": Number(-1, 1),
    "ovality_axis_rad": Number(-1e3, 1e3, "rad"),
    "softening_strain": Number(0, math.inf),
    "softening_fraction": Number(0, 1e3),
    "shaft_compliance_rad_per_Nm": Number(0, 1e6, "rad/(N m)"),
}
SECTION_RANGES = {
    "length_m": Number(0, 5, "m", above=True),
    "curvature_x_per_m": Number(-1e4, 1e4, "1/m"),
    "curvature_y_per_m": Number(-1e4, 1e4, "1/m"),
    "gradient": Number(-1e3, 1e3),
}


@dataclass(frozen=True)
class TubeSection:
    """A piece of constant or linearly varying precurvature, a rotation rate: y > 0 bends towards +x at theta = 0."""

    length_m: float
    curvature_x_per_m: float
    curvature_y_per_m: float
    gradient: float = 0.0  # precurvature at x from its base: (1 + gradient (2 x / length - 1)) times the mean

    @property
    def curvature_per_m(self) -> float:
        """Magnitude [1/m] of the precurvature."""
        return math.hypot(self.curvature_x_per_m, self.curvature_y_per_m)


@dataclass(frozen=True)
class Tube:
    """One tube, its sections from base to tip; torsional stiffness is bending_stiffness_Nm2 / (1 + poisson_ratio)."""

    outer_diameter_m: float
    inner_diameter_m: float  # 0: a wire
    bending_stiffness_Nm2: float
    poisson_ratio: float  # calibrated values may be negative
    sections: tuple[TubeSection, ...]
    collar_length_m: float = 0.0  # least distance of this tube's base behind the base of the tube around it
    max_strain: float = 0.08
    density_kg_m3: float = 0.0
    ovality: float = 0.0  # EI (1 + ovality) for bending along one axis, EI (1 - ovality) across
    ovality_axis_rad: float = 0.0  # of that axis in the tube
    softening_strain: float = math.inf  # of r_out |u - u_hat|, where the bending stiffness drops (NiTi)
    softening_fraction: float = 1.0  # tangent stiffness beyond it over EI
    shaft_compliance_rad_per_Nm: float = 0.0  # torsion between actuator and collar
    retractable: bool = False  # whether its tip may be drawn back behind that of the tube around it

    @property
    def mass_per_length_kg_m(self) -> float:
        """Density times the cross section."""
        return self.density_kg_m3 * math.pi / 4 * (self.outer_diameter_m**2 - self.inner_diameter_m**2)

    @property
    def length_m(self) -> float:
        """Length [m] from base to tip."""
        return math.fsum(section.length_m for section in self.sections)


@dataclass(frozen=True)
class Contact:
    """Contact of tubes i and i + 1."""

    friction_coefficient: tuple[float, float]  # lowest, highest
    clearance_m: float | None = None  # radial; None: what the diameters leave

    def __post_init__(self) -> None:
        """Raises InputError unless the friction coefficient is an interval."""
        try:
            lowest, highest = self.friction_coefficient
            sound = 0 <= lowest <= highest < math.inf
        except (TypeError, ValueError):
            sound = False
        if not sound:
            rule = "must be two numbers, lowest and highest, from 0 upwards"
            raise InputError(rule, key="friction_coefficient", value=self.friction_coefficient)
