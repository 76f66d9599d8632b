"""Every number of a robot file has two ends, stated here once more: beyond them it is refused by its key."""

from __future__ import annotations

import copy
from typing import Any

import pytest
from places import SCENARIOS

from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.storage.toml_document import read_document

TURNS, RATE, GEAR, TRAVEL = (-360_000.0, 360_000.0), (1e-3, 1e6), (-1000.0, 1000.0), (-5000.0, 5000.0)
CURVED, STIFF, MODULUS, SIGMA = (-1000.0, 1000.0), (1e-9, 1e6), (1e-6, 1e4), (1e-6, 1000.0)
ENDS: dict[str, tuple[float, float]] = {
    "tube.1.outer_diameter_mm": (0, 1000), "tube.1.inner_diameter_mm": (0, 1000),
    "tube.1.section.1.length_mm": (0, 5000), "tube.2.section.1.radius_mm": (0, 1e6),
    "tube.1.section.1.curvature_x_per_m": CURVED, "tube.1.section.1.curvature_y_per_m": CURVED,
    "tube.1.bending_stiffness_Nm2": STIFF, "tube.1.poisson_ratio": (-0.999, 99),
    "tube.2.youngs_modulus_GPa": MODULUS, "tube.2.shear_modulus_GPa": MODULUS, "tube.1.torsional_stiffness_Nm2": STIFF,
    "tube.1.collar_length_mm": (0, 5000), "tube.1.max_strain": (0, 1), "tube.1.density_kg_m3": (0, 1e5),
    "contact.1.friction_coefficient": (0, 2), "contact.1.clearance_mm": (0, 1000), "home.theta_deg.1": TURNS,
    "home.l_mm.1": TRAVEL, "joint.1.moves.theta.1": GEAR, "joint.3.moves.l.2": GEAR, "joint.1.min_deg": TURNS,
    "joint.1.max_deg": TURNS, "joint.3.min_mm": TRAVEL, "joint.3.max_mm": TRAVEL,
    **{f"joint.1.max_{name}": RATE for name in ("velocity_deg_s", "acceleration_deg_s2", "jerk_deg_s3")},
    **{f"joint.3.max_{name}": RATE for name in ("velocity_mm_s", "acceleration_mm_s2", "jerk_mm_s3")},
    "execution.rotation_deg": (0, 20), "execution.translation_mm": (0, 5), "model_error_mm": (0, 1000),
    "friction_memory": (0, 1), "measurement.position_sigma_mm": SIGMA, "measurement.tangent_sigma_deg": (1e-6, 180),
    "marker.1.tube": (1, 2), "marker.1.from_tip_mm": (0, 1e5), "marker.2.from_base_mm": (0, 1e5),
    "marker.1.position_sigma_mm": SIGMA, "uncertainty.correlation.1.2": (-1.001, 1.001),
}  # fmt: skip


def whole() -> dict[str, Any]:
    """A robot file with every table."""
    content = copy.deepcopy(read_document(SCENARIOS / "robots" / "table_5_pair.toml").content)
    content["marker"] = [{"name": "a", "tube": 2, "from_tip_mm": 1.0}, {"name": "b", "tube": 2, "from_base_mm": 1.0}]
    content |= {"execution": {}, "measurement": {"position_sigma_mm": 0.1, "tangent_sigma_deg": 1.0}}
    content["uncertainty"] = {"correlation": [[1.0, 0.0], [0.0, 1.0]]}
    return content


CONTENT = whole()
METAL = {"youngs_modulus_GPa": 60.0, "shear_modulus_GPa": 23.0}  # in the place of a stiffness and Poisson's ratio


def said_by(key: str) -> dict[str, Any]:
    """A robot file whose second tube is said by the key, where it may be said in several ways."""
    content = copy.deepcopy(CONTENT)
    tube = content["tube"][1]
    if "modulus" in key:
        content["tube"][1] = {
            name: tube[name] for name in ("outer_diameter_mm", "inner_diameter_mm", "section")
        } | METAL
    if "radius" in key:
        tube["section"][0] = {"length_mm": tube["section"][0]["length_mm"], "radius_mm": 100.0}
    return content


@pytest.mark.parametrize("key", ENDS)
def test_a_number_beyond_its_ends_is_refused_by_its_key(key: str) -> None:
    for end, sign in zip(ENDS[key], (-1, 1), strict=True):
        beyond = end + sign * (1 if key.endswith(".tube") else max(1e-3 * abs(end), 1e-9))
        with pytest.raises(InputError) as refusal:
            robot_from_dict(said_by(key), overrides=[f"{key}={beyond!r}"])
        assert refusal.value.key == key and refusal.value.value == beyond, str(refusal.value)


@pytest.mark.parametrize(
    ("key", "values", "rule"),
    [
        ("youngs_modulus_GPa", {"outer_diameter_mm": 900, "youngs_modulus_GPa": 1e4}, "makes a bending stiffness of"),
        ("shear_modulus_GPa", {"shear_modulus_GPa": 1e-6}, "makes EI / GJ ="),
    ],
)
def test_what_follows_from_moduli_has_ends_too(key: str, values: dict[str, float], rule: str) -> None:
    content = said_by(key)
    del content["uncertainty"]
    robot_from_dict(content)
    content["tube"] = [content["tube"][1] | values]
    content |= {"contact": [], "home": {"theta_deg": [0], "l_mm": [0]}, "marker": []}
    del content["joint"]
    with pytest.raises(InputError, match=rule):
        robot_from_dict(content)
