"""A robot file is read as it stands, in SI units. What is refused is in test_robot_file_refusals.py."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from pair_file import pair

from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict


def test_values_arrive_in_si_units() -> None:
    content = pair()
    robot = robot_from_dict(content)
    for tube, table in zip(robot.tubes, content["tube"], strict=True):
        assert tube.outer_diameter_m * 1e3 == pytest.approx(table["outer_diameter_mm"], rel=1e-15)
        assert tube.inner_diameter_m * 1e3 == pytest.approx(table["inner_diameter_mm"], rel=1e-15)
        assert tube.collar_length_m * 1e3 == pytest.approx(table.get("collar_length_mm", 0), rel=1e-15)
        assert tube.bending_stiffness_Nm2 == table["bending_stiffness_Nm2"]
        assert tube.poisson_ratio == table["poisson_ratio"]
        assert tube.length_m * 1e3 == pytest.approx(sum(s["length_mm"] for s in table["section"]), rel=1e-15)
        assert [s.curvature_y_per_m for s in tube.sections] == [s["curvature_y_per_m"] for s in table["section"]]
    assert robot.measurement is not None
    assert robot.measurement.position_sigma_m == pytest.approx(0.4e-3, rel=1e-15)
    assert math.degrees(robot.measurement.tangent_sigma_rad) == pytest.approx(0.5, rel=1e-15)
    assert np.degrees(robot.drive.home_theta_rad) == pytest.approx([0, 90], rel=1e-15)
    assert robot.drive.home_l_m * 1e3 == pytest.approx([0, -17], rel=1e-15)
    assert robot.clearance_m * 1e3 == pytest.approx([0.05], rel=1e-12)
    assert robot.friction.tolist() == [[0.2, 0.2]]


def test_a_friction_interval_and_a_given_clearance_are_kept() -> None:
    robot = robot_from_dict(pair("= 0.2\n", "= [0.15, 0.25]\nclearance_mm = 0.09\n"))
    assert robot.friction.tolist() == [[0.15, 0.25]]
    assert robot.clearance_m * 1e3 == pytest.approx([0.09], rel=1e-12)
    assert robot.warnings == ()  # within the rounding of diameters


def test_effects_are_kept_as_they_stand_and_put_to_work() -> None:
    terms = {"tip_load": {"force_x_N": 0.1, "provenance": {"data": "a.csv", "day": "monday"}}}
    assert robot_from_dict({**pair(), "effects": terms}).effects == terms


def test_doubtful_clearances_are_warned_about() -> None:
    disagree = robot_from_dict(pair("= 0.2\n", "= 0.2\nclearance_mm = 0.11\n"), file="a.toml")
    assert disagree.warnings == (
        "a.toml: contact.1: radial clearance 0.11 mm is used, but the diameters leave 0.05 mm.",
    )
    wide = pair("outer_diameter_mm = 1.3\ninner_diameter_mm = 1.1", "outer_diameter_mm = 9\ninner_diameter_mm = 8")
    assert robot_from_dict(wide, file="a.toml").warnings == (
        "a.toml: tube.2.outer_diameter_mm = 1.0 mm: leaves 3.5 mm on every side, room for a tube twice as wide: are "
        "its diameters radii?",
        "a.toml: contact.1: radial clearance 3.5 mm is above 2 % of the smallest radius of curvature (153.846 mm), "
        "the model is less accurate there.",
    )


def test_clearances_that_no_mesh_resolves_are_warned_about() -> None:
    tight = robot_from_dict(pair("= 0.2\n", "= 0.2\nclearance_mm = 0.001\n"), file="a.toml")
    assert [text for text in tight.warnings if "below 0.005 mm" in text]


def test_numbers_of_numpy_are_numbers() -> None:
    content = pair()
    content["tube"][0]["poisson_ratio"] = np.float64(0.25)
    content["home"] = {"theta_deg": np.array([0.0, 90.0]), "l_mm": [np.int64(0), np.int64(-17)]}
    robot = robot_from_dict(content)
    assert robot.tubes[0].poisson_ratio == 0.25
    assert np.degrees(robot.drive.home_theta_rad) == pytest.approx([0, 90])


@pytest.mark.parametrize(
    "effect", ["homing_offset.theta_2_deg=1", "joint_scale.theta_2=0.02", "eccentricity.sin_2_deg=1"]
)
def test_a_robot_with_effects_of_its_drive_is_pickled(effect: str) -> None:
    robot = robot_from_dict(pair(), overrides=[f"effects.{effect}"])
    again = pickle.loads(pickle.dumps(robot))
    joints = np.array([[0.3, -0.02]])
    np.testing.assert_array_equal(again.drive.collars(joints), robot.drive.collars(joints))


def test_one_tube_needs_no_contact_and_thirteen_are_refused() -> None:
    content = pair()
    alone = {"tube": content["tube"][:1]}
    robot = robot_from_dict(alone)
    assert (robot.n, robot.clearance_m.shape, robot.friction.shape) == (1, (0,), (0, 2))
    with pytest.raises(InputError, match=r"^tube: must be a list of length <= 12\.$"):
        robot_from_dict({"tube": alone["tube"] * 13})
