"""The robots that come along: those of the paper, and needles for public patients."""

from __future__ import annotations

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.files.robot_file import load_robot
from ctrplan.robot.robot import nesting_violation

SHIPPED = ROBOTS

SHIPPED_CLEARANCES_MM = {
    "brain_cannula": [0.05],
    "liver_needle": [0.05],
    "lung_needle": [0.05],
    "table_1_pair": [0.05],
    "table_4_pair": [1.625],
    "table_5_pair": [0.0375],
    "three_tube": [0.0425, 0.0625],
    "three_tube_calibrated": [0.0425, 0.0625],
    "three_tube_insertion": [0.0425, 0.0625],
}
SHIPPED_RADII_MM = {  # y-curvature of the curved section of each tube
    "brain_cannula": [np.inf, 60],
    "liver_needle": [np.inf, 80],
    "lung_needle": [np.inf, 60],
    "table_1_pair": [150, 150],
    "table_4_pair": [365, 56],
    "table_5_pair": [288.1, 79.3],
    "three_tube": [265, 265, 55],
    "three_tube_calibrated": [282.8, 212.6, 62.37],
    "three_tube_insertion": [265, 265, 55],
}


def test_every_shipped_robot_is_listed_here() -> None:
    assert {path.stem for path in SHIPPED.glob("*.toml")} == set(SHIPPED_CLEARANCES_MM)


@pytest.mark.parametrize("name", SHIPPED_CLEARANCES_MM)
def test_shipped_robots_have_the_dimensions_that_they_are_known_for(name: str) -> None:
    robot = load_robot(SHIPPED / f"{name}.toml")
    assert robot.clearance_m * 1e3 == pytest.approx(SHIPPED_CLEARANCES_MM[name], rel=1e-12)
    curvatures_per_m = [tube.sections[-1].curvature_y_per_m for tube in robot.tubes]
    assert curvatures_per_m == pytest.approx([1e3 / radius for radius in SHIPPED_RADII_MM[name]], rel=1e-10)
    assert len(robot.warnings) == (name == "table_4_pair")
    q = np.zeros(len(robot.drive.joints))
    for moved in (q, np.where(robot.drive.is_rotation, 0, robot.drive.lower)):
        assert nesting_violation(robot, *robot.drive.collars(moved)) is None


def test_calibrated_values_are_those_of_tables_five_and_seven() -> None:
    pair_, three = load_robot(SHIPPED / "table_5_pair.toml"), load_robot(SHIPPED / "three_tube_calibrated.toml")
    stiffness = [tube.bending_stiffness_Nm2 / 5.07e-2 for tube in (*pair_.tubes, *three.tubes)]
    assert stiffness == pytest.approx([1, 0.221, 1, 0.9929, 0.1990], rel=1e-6)
    assert [tube.poisson_ratio for tube in three.tubes] == [0.3, 0.3256, -0.1543]
    x_radii_m = [1 / tube.sections[-1].curvature_x_per_m for tube in (*pair_.tubes, *three.tubes)]
    assert x_radii_m == pytest.approx([-24.9684, -2.5907, -291.3, -9.879, -3.313], rel=1e-9)
