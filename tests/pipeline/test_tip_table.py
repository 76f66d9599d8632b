"""Tips of friction states: what a pair without friction went through changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from measured_data import pair_robot

from ctrplan.base.arrays import Array
from ctrplan.mechanics.core import Mechanics
from ctrplan.pipeline import tip_table as tip_table_module
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


def test_derivatives_that_are_asked_together_are_those_asked_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """And nothing is solved for a name that was asked before."""
    names, robot = ("tube.2.bending_stiffness_Nm2", FRICTION, "theta_b.2", "contact.1.clearance_m"), pair_robot()
    tip_table_module._remembered.cache_clear()
    together = tips(robot, *names)
    asked: list[tuple[str, ...]] = []
    solve = Mechanics.tips_with_friction

    def counted(self: Mechanics, *rows: Array, **how: Any) -> object:
        asked.append(tuple(how["parameters"]))
        return solve(self, *rows, **how)

    monkeypatch.setattr(Mechanics, "tips_with_friction", counted)
    for k, name in enumerate(names):
        np.testing.assert_array_equal(tips(robot, name).position_by[:, :, 0], together.position_by[:, :, k])
    assert not asked
    tips(robot, "theta_b.1", "theta_b.2")
    assert asked == [("theta_b.1",)]
