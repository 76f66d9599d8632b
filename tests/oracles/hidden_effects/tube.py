"""A tube of the true robot: what it is made of, and every way in which it may deviate from a drawing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROUNDING = 0.1


@dataclass(frozen=True)
class Section:
    """Rotation rate u = (u_x, u_y) [1/m] in the tube's frame, plus `gradient` times it per half length."""

    length_m: float
    curvature_per_m: tuple[float, float]
    gradient: float = 0.0


@dataclass(frozen=True)
class Kink:
    """Rotation rate [1/m] added over `width_m` around `x_m` from the tube's base."""

    x_m: float
    width_m: float
    curvature_per_m: tuple[float, float]


@dataclass(frozen=True)
class Softening:
    """Beyond the strain r_out |u - u_hat| the slope of the bending moment falls to `fraction` of the stiffness.

    The corner is rounded over ROUNDING of the strain, for Newton's method.
    """

    strain: float
    fraction: float

    def excess(self, size: Array, radius_m: float) -> tuple[Array, Array, Array]:
        """How far curvatures (S,) [1/m] are beyond the limit, the derivative and the integral of that; 0 at size 0."""
        limit = self.strain / radius_m
        w, x = ROUNDING * limit, size - limit
        corner = np.clip(x + w, 0, 2 * w)
        beyond = np.maximum(x - w, 0)
        return corner**2 / (4 * w) + beyond, corner / (2 * w), corner**3 / (12 * w) + beyond * (w + beyond / 2)


@dataclass(frozen=True)
class Tube:
    """Radii [m], stiffness [N m^2], sections from base to tip; the rest is zero for a tube as drawn."""

    outer_radius_m: float
    inner_radius_m: float
    bending_stiffness_Nm2: float
    poisson_ratio: float
    sections: tuple[Section, ...]
    ovality: float = 0.0  # EI (1 +- ovality) for bending towards the tube's own x and y
    softening: Softening | None = None
    kinks: tuple[Kink, ...] = field(default=())
    shaft_compliance_rad_per_Nm: float = 0.0  # between actuator and collar
    weight_N_per_m: float = 0.0

    @property
    def length_m(self) -> float:
        return sum(section.length_m for section in self.sections)

    @property
    def torsional_stiffness_Nm2(self) -> float:
        return self.bending_stiffness_Nm2 / (1 + self.poisson_ratio)

    @property
    def joints_m(self) -> list[float]:
        """Ends of sections, from the base: 0, ..., length."""
        return [0.0, *np.cumsum([section.length_m for section in self.sections]).tolist()]

    def eased(self, share: float) -> Tube:
        """With only a share of softening, ovality and shaft compliance (which stays above zero if it was)."""
        soft = self.softening and replace(self.softening, fraction=1 - share * (1 - self.softening.fraction))
        compliance = self.shaft_compliance_rad_per_Nm * max(share, 1e-3)
        return replace(self, softening=soft, ovality=share * self.ovality, shaft_compliance_rad_per_Nm=compliance)

    def precurvature(self, x_m: Array) -> Array:
        """Curvature vector (u_y, -u_x) [1/m] of the unloaded tube at x (S,) from its base, in its own frame: (S, 2)."""
        rate = np.zeros((len(x_m), 2))
        start = 0.0
        for section in self.sections:
            inside = (x_m >= start) & (x_m < start + section.length_m)
            where = 2 * (x_m[inside] - start) / section.length_m - 1
            rate[inside] = np.outer(1 + section.gradient * where, section.curvature_per_m)
            start += section.length_m
        for kink in self.kinks:
            rate[np.abs(x_m - kink.x_m) < kink.width_m / 2] += kink.curvature_per_m
        return np.column_stack([rate[:, 1], -rate[:, 0]])

    def moment(self, e: Array) -> tuple[Array, Array]:
        """Bending moment (S, 2) and its derivative (S, 2, 2) at curvatures e (S, 2) beyond the precurvature."""
        if self.softening is not None:
            return self._soft_moment(e, self.softening)
        stiffness = self.bending_stiffness_Nm2 * np.array([1 + self.ovality, 1 - self.ovality])
        return e * stiffness, np.broadcast_to(np.diag(stiffness), (len(e), 2, 2))

    def energy_density(self, e: Array) -> Array:
        """Bending energy per length (S,) [N] at e (S, 2), whose gradient is `moment`."""
        if self.softening is None:
            return np.asarray(np.sum(e * self.moment(e)[0], axis=1) / 2)
        soft, size = self.softening, np.linalg.norm(e, axis=1)
        excess = soft.excess(size, self.outer_radius_m)[2]
        return np.asarray(self.bending_stiffness_Nm2 * (size**2 / 2 - (1 - soft.fraction) * excess))

    def _soft_moment(self, e: Array, soft: Softening) -> tuple[Array, Array]:
        EI, size = self.bending_stiffness_Nm2, np.maximum(np.linalg.norm(e, axis=1), 1e-9)
        excess, rate, _ = soft.excess(size, self.outer_radius_m)
        secant = EI * (1 - (1 - soft.fraction) * excess / size)
        slope = EI * (1 - (1 - soft.fraction) * rate)
        along = e / size[:, None]
        stiffness = secant[:, None, None] * np.eye(2)
        stiffness = stiffness + (slope - secant)[:, None, None] * along[:, :, None] * along[:, None, :]
        return e * secant[:, None], stiffness
