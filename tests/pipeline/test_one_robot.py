"""A robot file with effects is the same robot to whoever asks: fits, simulate, bound, sweep, ik, view and planner.

Every effect of mechanics and drive that acts at rest, alone and beside another of its stage, at several commanded
configurations: the frictionless tips that all of them tell agree.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from effect_values import effects, pairs_of
from measured_data import pair_robot

from ctrplan.__main__ import main
from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import CATALOGUE
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.joint_path import JointPath
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.core import Mechanics
from ctrplan.motion.checker import MotionChecker
from ctrplan.pipeline.chain import Chain
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.reports.live_state import LiveState
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.tip_solver import TipSolver, TipTarget
from ctrplan.studies.simulate import simulate
from ctrplan.studies.sweep import parse_axis, sweep

PLAIN = pair_robot(contact=[{"friction_coefficient": 0.1}])
AT_REST = [name for name, e in CATALOGUE.items() if e.stage in ("drive", "mechanics") and e.acts_at_rest]
STAGES = [[name for name in AT_REST if CATALOGUE[name].stage == stage] for stage in ("drive", "mechanics")]
PAIRS = [pair for stage in STAGES for pair in pairs_of(stage)]
COMMANDED = (
    np.array([[0.3, 1.4], [-0.5, 2.2], [0.0, 0.4]]),
    np.array([[-3e-3, -0.02], [-5e-3, -0.025], [-2e-3, -0.03]]),
)
SAME_M = 1e-6
LOGS_ALONE = (["translation_release"], ["homing_shift"])  # act along a path, and in runs of later homings


def with_effects(*names: str) -> Robot:
    return robot_from_dict({**PLAIN.content, "effects": effects(names, PLAIN)})


def told_by_the_chain(robot: Robot) -> Array:
    """Tips that the chain predicts for poses at rest whose last directions nobody knows."""
    count = len(COMMANDED[0])
    nothing = np.zeros((count, 3))
    data = Measurements(np.arange(count), *COMMANDED, np.arange(count), nothing, nothing, np.zeros(count))
    chain = Chain.of(robot)
    collars = chain.collars(data, np.zeros((count, 4)))
    rows = zip(collars.theta, collars.l, strict=True)
    return np.array([chain.mechanics.solve(*row).tip_m for row in rows])


@pytest.mark.parametrize("names", [*([name] for name in AT_REST), *PAIRS], ids="+".join)
def test_everybody_is_told_the_same_robot(names: list[str]) -> None:
    robot = with_effects(*names)
    joints = np.hstack(COMMANDED) - np.concatenate([robot.drive.home_theta_rad, robot.drive.home_l_m])
    expected = told_by_the_chain(robot)
    bounds = robot.bound_many(*robot.collars(*COMMANDED))
    np.testing.assert_allclose(bounds.tip_m, expected, atol=SAME_M, err_msg="bound")
    np.testing.assert_allclose(robot.bound_many(*robot.drive.collars(joints)).tip_m, expected, atol=SAME_M)
    plain = PLAIN.bound_many(*COMMANDED)
    acted = np.abs(bounds.tip_m - plain.tip_m).max() + np.abs(bounds.position_m - plain.position_m).max()
    assert (acted > 1e-6) == (names not in LOGS_ALONE)
    path = JointPath(*COMMANDED, np.arange(3))
    np.testing.assert_allclose(simulate(robot, path).bounds.tip_m, expected, atol=SAME_M, err_msg="simulate")
    checker = MotionChecker(bare_scenario(robot))
    for q, tip in zip(joints, expected, strict=True):
        samples = checker.probe(q)[1]
        assert samples is not None
        np.testing.assert_allclose(samples.tip_m[-1], tip, atol=SAME_M, err_msg="planner")


@pytest.mark.parametrize("name", AT_REST)
def test_a_fit_predicts_what_the_bound_says(name: str) -> None:
    """Poses that were reached by no motion at all: friction is released, directions are unknown."""
    robot, count = with_effects(name), len(COMMANDED[0])
    nothing = np.zeros((count, 3))
    data = Measurements(np.arange(count), *COMMANDED, np.arange(count), nothing, nothing, np.zeros(count))
    predicted = ParametricChain(robot, data, []).predict(np.zeros(0), derivatives=False)
    np.testing.assert_allclose(predicted.position_m, told_by_the_chain(robot), atol=SAME_M)


@pytest.mark.parametrize("name", AT_REST)
def test_the_commands_tell_the_same_robot(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = with_effects(name)
    file = tmp_path / "robot.toml"
    file.write_text(tomli_w.dumps(dict(robot.content)))
    expected = told_by_the_chain(robot)[0] * 1e3
    theta, l = np.degrees(COMMANDED[0][0]), COMMANDED[1][0] * 1e3  # noqa: E741
    values = ["--theta-deg", *map(repr, theta.tolist()), "--l-mm", *map(repr, l.tolist())]
    assert main(["bound", str(file), *values, "--json", "--accuracy", "search"]) == 0
    said = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(said["frictionless"]["tip_mm"], expected, atol=SAME_M * 1e3)
    axis = parse_axis(f"theta_2={theta[1]}:{theta[1] + 1}:2", 2)
    swept = sweep(robot.content, [axis], *(part[0] for part in COMMANDED)).bounds
    np.testing.assert_allclose(swept.tip_m[0] * 1e3, expected, atol=SAME_M * 1e3)
    assert swept.position_m[0] * 1e3 == pytest.approx(said["bound_position_mm"], rel=1e-6)
    live = LiveState(bare_scenario(robot))
    joints = [*theta, *(l - robot.drive.home_l_m * 1e3)]
    shown: Mapping[str, object] = live.at([float(value) for value in joints])
    assert float(str(shown["bound_mm"])) == pytest.approx(said["bound_position_mm"], abs=6e-3)


@pytest.mark.parametrize("name", STAGES[0])
def test_inverse_kinematics_moves_the_joints_of_this_drive(name: str) -> None:
    """The tip of some joint values is a target: the solver's answer, sent to the drive, puts the tip there."""
    robot = with_effects(name)
    space = JointSpace.of_robot(robot)
    joints = np.hstack(COMMANDED) - np.concatenate([robot.drive.home_theta_rad, robot.drive.home_l_m])
    solver = TipSolver(space, robot.mechanics)
    target = solver.tips(joints[:1])[0][0]
    found = solver.solve(TipTarget(target), joints[1:])
    assert found.error_m.min() < 1e-5
    best = found.joints[int(np.argmin(found.error_m))]
    chain = Chain.of(robot)
    collars = chain.drive(_commanded(robot, best), np.zeros((1, 4)))
    tips, *_ = Mechanics(robot.tubes, robot.clearance_m, robot.friction[:, 1], robot.loads).tips(
        collars.theta, collars.l
    )
    np.testing.assert_allclose(tips[0], target, atol=2e-5)


def _commanded(robot: Robot, q: Array) -> Collars:
    return Collars(*(part[None] for part in robot.drive.commanded(q)))


def test_a_homing_offset_of_sixty_degrees_changes_the_bound() -> None:
    """Once `ctrplan bound` said 3.096 mm with it and without it."""
    robot = robot_from_dict({**PLAIN.content, "effects": {"homing_offset": {"theta_2_deg": 60.0}}})
    theta, l = [0.0, np.radians(60.0)], [-2e-3, -0.02]  # noqa: E741
    turned = PLAIN.bound([0.0, np.radians(120.0)], l)
    assert robot.bound(*robot.collars(theta, l)).position_m == pytest.approx(turned.position_m, rel=1e-6)
    assert abs(turned.position_m - PLAIN.bound(theta, l).position_m) > 1e-4
