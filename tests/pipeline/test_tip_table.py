"""Tips of friction states: what a pair without friction went through changes nothing."""

from __future__ import annotations

import numpy as np
from measured_data import pair_robot

from ctrplan.pipeline.tip_table import TipTable, tip_table
from ctrplan.robot.robot import Robot

FRICTION = "contact.1.friction_coefficient"
STATES = np.array([[-1.0], [0.0], [1.0]])


def tips(robot: Robot, *names: str) -> TipTable:
    theta, l_b = np.tile([0.0, 1.2], (3, 1)), np.tile([0.0, -0.03], (3, 1))
    return tip_table(robot, theta, l_b, STATES, names)


def test_a_pair_without_friction_has_one_tip_in_all_its_states() -> None:
    """The one that the core finds in each state."""
    robot = pair_robot()
    found = tips(robot).position_m
    assert (found == found[0]).all()
    theta, l_b = np.array([[0.0, 1.2]]), np.array([[0.0, -0.03]])
    for state, here in zip(STATES, found, strict=True):
        alone = robot.mechanics.tips_with_friction(theta, l_b, state[None])
        np.testing.assert_allclose(here, alone.position_m[0], atol=1e-7)


def test_derivatives_by_friction_know_the_state() -> None:
    """Where friction starts: nothing when released, and opposite in opposite states."""
    by = tips(pair_robot(), FRICTION).position_by[:, :, 0]
    size = np.linalg.norm(by[2])
    assert size > 1e-4
    np.testing.assert_allclose(by[0], -by[2], atol=0.02 * size)
    assert np.linalg.norm(by[1]) < 0.02 * size
