"""The robot file that several tests read, damage and compare."""

from __future__ import annotations

import sys
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PAIR = """
name = "pair"
[[tube]]
outer_diameter_mm = 1.3
inner_diameter_mm = 1.1
bending_stiffness_Nm2 = 0.05
poisson_ratio = 0.3
[[tube.section]]
length_mm = 150
curvature_x_per_m = 0
curvature_y_per_m = 6.5
[[tube]]
outer_diameter_mm = 1.0
inner_diameter_mm = 0.8
bending_stiffness_Nm2 = 0.04
poisson_ratio = -0.2
collar_length_mm = 17
[[tube.section]]
length_mm = 200
curvature_x_per_m = 0
curvature_y_per_m = 5
[[contact]]
friction_coefficient = 0.2
[measurement]
position_sigma_mm = 0.4
tangent_sigma_deg = 0.5
[home]
theta_deg = [0, 90]
l_mm = [0, -17]
[[joint]]
name = "rotate inner"
moves = { theta = [0, 1] }
max_velocity_deg_s = 30
[[joint]]
name = "translate inner"
moves = { l = [0, 1] }
min_mm = -33
max_mm = 0
max_velocity_mm_s = 5
"""


def pair(old: str = "", new: str = "") -> dict[str, Any]:
    """Content of PAIR, with the first `old` replaced."""
    assert old in PAIR
    return tomllib.loads(PAIR.replace(old, new, 1))
