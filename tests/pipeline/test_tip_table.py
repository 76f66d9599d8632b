"""Tips of friction states: what a pair without friction went through changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from measured_data import pair_robot

from ctrplan.base.arrays import Array
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.core_arrays import TipMemory
from ctrplan.pipeline import tip_table as tip_table_module
from ctrplan.pipeline.tip_table import TipTable, tip_table
from ctrplan.robot.named_numbers import with_values
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


def test_solutions_near_known_ones_are_those_found_afresh() -> None:
    """Solutions kept of robots that hardly differ, and places that stand for other configurations than before."""
    random, near = np.random.default_rng(2), (TipMemory(), list(range(24)))
    theta = np.column_stack([np.zeros(24), random.uniform(-np.pi, np.pi, 24)])
    l_b = np.column_stack([np.zeros(24), random.uniform(-0.04, -0.02, 24)])
    state, order = random.uniform(-1, 1, (24, 1)), np.arange(24)
    for k in range(6):
        changes = {"tube.2.poisson_ratio": random.uniform(0.25, 0.35), FRICTION: random.uniform(0.1, 0.3)}
        mechanics = with_values(pair_robot(), changes).mechanics
        rows = theta[order], l_b[order], state[order]
        known, afresh = mechanics.tips_with_friction(*rows, near=near), mechanics.tips_with_friction(*rows)
        np.testing.assert_allclose(known.position_m, afresh.position_m, atol=1e-9)
        np.testing.assert_array_equal(known.status, afresh.status)
        order = random.permutation(24) if k == 3 else order


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
