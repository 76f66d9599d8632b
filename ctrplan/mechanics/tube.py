"""Precurved tubes and the contacts between neighbours, outermost first."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ctrplan.errors import InputError


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
