"""From no tube to twelve, and files of sizes that nobody expects: a robot, a table, or one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_input import assert_names_the_fault

from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.mechanics.shapes import Status
from ctrplan.scenario.joint_space import bare_scenario


def nested_tubes(count: int) -> dict[str, Any]:
    """Content of a robot file: slender, gently curved tubes, outermost first."""
    tubes = [
        {
            "outer_diameter_mm": 8 - 0.6 * i,
            "inner_diameter_mm": 7.5 - 0.6 * i,
            "bending_stiffness_Nm2": 0.05,
            "poisson_ratio": 0.3,
            "section": [{"length_mm": 40 + 5 * i, "curvature_x_per_m": 0, "curvature_y_per_m": 1.0}],
        }
        for i in range(count)
    ]
    return {"tube": tubes, "contact": [{"friction_coefficient": 0.1}] * (count - 1)}


@pytest.mark.parametrize("text", ["", "tube = []", "name = 'nothing'\ncontact = []", "[[contact]]\n"])
def test_no_tube_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        load_robot(file)
    assert_names_the_fault(caught.value, str(file))


def test_a_tube_without_sections_is_refused() -> None:
    content = nested_tubes(2)
    content["tube"][1]["section"] = []
    with pytest.raises(InputError, match=r"^tube\.2\.section = \[\]: must be a list of length >= 1\.$"):
        robot_from_dict(content)


def test_a_single_tube_has_its_own_shape_and_a_bound_of_zero() -> None:
    """A circle of curvature 1 / m: the tip of 40 mm of it is known in closed form."""
    robot = robot_from_dict(nested_tubes(1))
    bound = robot.bound([0.0], [0.0])
    angle = 0.04 * 1.0
    np.testing.assert_allclose(bound.frictionless.tip_m, [1 - np.cos(angle), 0, np.sin(angle)], atol=1e-7)
    assert bound.position_m < 1e-12 and len(bound.corners) == 1
    history = robot.history().follow([[0.0], [1.0]], [[0.0], [-0.01]])
    assert not history.snaps.any()


def test_twelve_tubes_have_a_shape() -> None:
    robot = robot_from_dict(nested_tubes(12))
    theta_b, l_b = robot.drive.collars(bare_scenario(robot).start)
    shape = robot.solve(theta_b, l_b, 1.0)
    assert shape.status <= Status.MULTIPLE and np.isfinite(shape.tip_m).all()
