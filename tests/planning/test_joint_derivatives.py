"""Derivatives by the joints go through the drive, its effects included: they are limits of differences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from effect_values import effects
from measured_data import pair_robot

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import CATALOGUE
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.reach import bound_slopes, tips_by_joints
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.tip_solver import TipSolver

PLAIN = pair_robot(contact=[{"friction_coefficient": 0.2}])
OF_THE_DRIVE = ["none", *(name for name, e in CATALOGUE.items() if e.stage == "drive"), "all"]
JOINTS = np.array([[0.3, 1.4, -4e-3, -0.02], [-0.5, 2.0, -5e-3, -0.024]])
EXACT = (1e-5, 1e-5, 1e-5, 1e-5)
STEP = np.array([1e-4, 1e-4, 1e-6, 1e-6])


def robot_with(name: str) -> Robot:
    names = {"none": [], "all": OF_THE_DRIVE[1:-1]}.get(name, [name])
    scaled = {"joint_scale": {"theta_1": 0.1, "theta_2": 0.3, "l_1": -0.1, "l_2": 0.2}}
    given = effects(names, PLAIN) | {key: value for key, value in scaled.items() if key in names}
    return robot_from_dict({**PLAIN.content, "effects": given})


def agrees(found: Array, expected: Array, share: Sequence[float]) -> None:
    """Derivatives (K, ..., m) by each joint, relative to the largest by it."""
    axes = tuple(range(found.ndim - 1))
    off = np.abs(found - expected).max(axis=axes) / np.abs(expected).max(axis=axes)
    assert (off < share).all(), off


def tips(robot: Robot, q: Array, phi: float = 0.0) -> Array:
    state = np.full((len(q), robot.n - 1), phi)
    return robot.mechanics.tips_with_friction(*robot.drive.collars(q), state).position_m


def differences(robot: Robot, phi: float) -> Array:
    """(K, 3, m) of tips."""
    columns = []
    for j, step in enumerate(STEP):
        up, down = JOINTS.copy(), JOINTS.copy()
        up[:, j] += step
        down[:, j] -= step
        columns.append((tips(robot, up, phi) - tips(robot, down, phi)) / (2 * step))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize("name", OF_THE_DRIVE)
@pytest.mark.parametrize("phi", [0.0, 1.0])  # without friction: the tip that compensation moves
def test_of_tips_with_friction(name: str, phi: float) -> None:
    """With joint_scale 0.3 it once said 11.8 where 15.4 mm/rad is true."""
    robot = robot_with(name)
    found = tips_by_joints(MotionChecker(bare_scenario(robot)), JOINTS, np.full((2, 1), phi)).position_by
    expected = differences(robot, phi)
    agrees(found, expected, EXACT)


@pytest.mark.parametrize("name", OF_THE_DRIVE)
def test_of_the_zero_clearance_tip(name: str) -> None:
    robot = robot_with(name)
    solver = TipSolver(JointSpace.of_robot(robot), robot.mechanics)
    found = solver.jacobian(JOINTS, *solver.tips(JOINTS))
    for j, step in enumerate(STEP):
        up, down = JOINTS.copy(), JOINTS.copy()
        up[:, j] += step
        down[:, j] -= step
        expected = (solver.tips(up)[0] - solver.tips(down)[0]) / (2 * step)
        np.testing.assert_allclose(found[:, :3, j], expected, atol=5e-3 * np.abs(expected).max())


@pytest.mark.parametrize("name", OF_THE_DRIVE)
def test_of_the_bound(name: str) -> None:
    robot = robot_with(name)
    found = bound_slopes(MotionChecker(bare_scenario(robot)), JOINTS).bound_by
    columns = []
    for j, step in enumerate(STEP):
        ends = []
        for side in (1, -1):
            q = JOINTS.copy()
            q[:, j] += side * step
            finished = robot.bounds(*robot.drive.collars(q), gradient=True).gradient
            assert finished is not None
            ends.append(finished.position_m.value)
        columns.append((ends[0] - ends[1]) / (2 * step))
    expected = np.stack(columns, axis=1)
    agrees(found, expected, EXACT)


def test_projections_know_where_the_drive_puts_the_collars() -> None:
    """Joint values that an offset and a scale take out of nesting come back by the drive's own numbers."""
    robot = robot_from_dict(
        {**PLAIN.content, "effects": {"homing_offset": {"l_2_mm": 6.0}, "joint_scale": {"l_2": -0.2}}}
    )
    space = JointSpace.of_robot(robot)
    q = np.array([[0.0, 0.5, -9e-3, -6e-3], [0.2, 0.1, -2e-3, -6e-3]])
    assert not space.allowed_rows(q).any()
    refused = np.full_like(q, np.nan)
    assert np.isfinite(space.projected(q, fallback=refused)).all()
