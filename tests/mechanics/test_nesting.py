"""One rule of nesting: the core's, the inequalities', and that by which translations are moved to where they nest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.tube import is_in_order, moved_to_nest, nests, reach_inequalities
from ctrplan.robot.robot import Robot, nesting_violation
from ctrplan.scenario.joint_space import JointSpace

THREE = load_robot(ROBOTS / "three_tube.toml")
SOFT = {"shaft_compliance_rad_per_Nm": 0.5, "collar_length_m": 0.0}
TWISTED = replace(THREE, tubes=tuple(replace(tube, **SOFT) for tube in THREE.tubes))


@pytest.fixture(params=["rigid shafts", "compliant shafts"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return {"rigid shafts": THREE, "compliant shafts": TWISTED}[request.param]


def translations(robot: Robot, count: int) -> Array:
    """(K, n) [m] some that nest, some that do not, some that only just do."""
    rng = np.random.default_rng(0)
    loose = rng.uniform(-0.15, 0.01, (count, robot.n)).cumsum(axis=1) * rng.uniform(0, 1, (count, 1))
    touching = moved_to_nest(robot.tubes, loose)
    signs = rng.integers(-1, 2, touching.shape)
    return np.vstack([loose, touching, touching + 0.2e-9 * signs, touching + 3e-7 * signs])


def test_the_core_the_sentences_and_the_joint_space_agree(robot: Robot) -> None:
    l_b, theta_b = translations(robot, 150), np.zeros(robot.n)
    nested, (G, h) = nests(robot.tubes, l_b), reach_inequalities(robot.tubes)
    far_m = (l_b @ G.T - h).max(axis=1)  # beyond what the core's rounding and its shafts' own room leave open
    assert 0.2 < nested.mean() < 0.9
    for row, is_nested, excess_m in zip(l_b, nested, far_m, strict=True):
        if is_nested:
            robot.zero_clearance(theta_b, row)
            assert nesting_violation(robot, theta_b, row) is None
        elif excess_m > 1e-7:
            with pytest.raises(InputError):
                robot.zero_clearance(theta_b, row)
    assert np.all(nested[far_m <= 0])
    space = JointSpace.of_robot(robot)
    np.testing.assert_array_equal(space.nesting_G, G)
    np.testing.assert_array_equal(space.nesting_h, h)


def test_what_is_moved_nests_and_what_nests_stays(robot: Robot) -> None:
    l_b = translations(robot, 150)
    l_b = l_b[l_b[:, 0] + robot.tubes[0].length_m > 1e-6]
    moved = moved_to_nest(robot.tubes, l_b)
    assert np.all(nests(robot.tubes, moved)) and np.all(is_in_order(robot.tubes, moved, 1e-8))
    np.testing.assert_array_equal(moved_to_nest(robot.tubes, moved), moved)
    kept = nests(robot.tubes, l_b)
    np.testing.assert_allclose(moved[kept], l_b[kept], atol=1e-9)
    assert np.all(np.abs(moved - l_b).max(axis=1)[~kept] > 1e-10)
