"""Names of what a robot's tip can be differentiated by, and what each means in the numbers of the core.

"tube.2.poisson_ratio", "contact.1.friction_coefficient", "l_b.3": keys of the robot file and joints, tubes and
contacts from 1, outermost first, values in SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ctrplan.errors import InputError
from ctrplan.mechanics.tube import Tube

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
