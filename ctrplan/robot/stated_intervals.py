"""95 % intervals of the numbers of a robot file, as calibrations write them into its table [uncertainty]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ctrplan.base.arrays import Array

# Keys of a robot file whose numbers may have an interval -> their names and SI values of their units.
# `curvature_per_m` is the magnitude of a section's precurvature, whose direction stays.
KEYS = {
    "bending_stiffness_Nm2": ("bending_stiffness_Nm2", 1.0),
    "poisson_ratio": ("poisson_ratio", 1.0),
    "curvature_per_m": ("curvature_per_m", 1.0),
    "curvature_x_per_m": ("curvature_x_per_m", 1.0),
    "curvature_y_per_m": ("curvature_y_per_m", 1.0),
    "length_mm": ("length_m", 1e-3),
    "clearance_mm": ("clearance_m", 1e-3),
    "friction_coefficient": ("friction_coefficient", 1.0),
}


@dataclass(frozen=True, eq=False)
class StatedIntervals:
    """What [uncertainty] says. Those of effects stand beside their values, in [effects.NAME] ci95.

    Names are those of `named_numbers.py`, as tube.2.section.1.curvature_per_m, or effects.friction.mu_1.
    """

    ci95: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # SI, of the file's own numbers
    correlated: tuple[str, ...] = ()  # Q names, the file's own numbers or parameters of effects
    correlation: Array | None = None  # (Q, Q) of their errors


def file_key(name: str, value: float) -> tuple[str, float]:
    """What a robot file calls a named number, and the value [SI] in the file's unit."""
    stem, last = name.rsplit(".", 1)
    key, si = next((key, si) for key, (known, si) in KEYS.items() if known == last)
    return f"{stem}.{key}", value / si
