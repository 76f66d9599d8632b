"""Plans that start from what an observer knows: predictions do, what is promised does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.audit.verify import broken_promises, recomputed_differences, verify
from ctrplan.certificate.certify import certify
from ctrplan.errors import CtrplanError, InputError
from ctrplan.files.plan_file import WrittenPlan, load_plan
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_scenario
from ctrplan.files.trajectory_file import trajectory_formats, write_trajectory
from ctrplan.plans.plan import write_plan_json
from ctrplan.robot.observer import ObserverState
from ctrplan.robot.robot import Robot
from ctrplan.scenario.prediction import predict
from ctrplan.scenario.scenario import Scenario

START = np.array([1.0, 3.2, -0.03])
WAY = np.array([START, START + [0.0, -0.2, 0.0]])
NOISE_M = 0.1e-3


def scenario() -> Scenario:
    return replace(load_scenario(SCENARIOS / "pair_free.toml"), start=START)


def followed_to_start(robot: Robot) -> ObserverState:
    """A robot that has turned its inner tube by 40 deg to where it starts, seen by a perfect tracker."""
    joints = np.linspace(START - [0.0, 0.7, 0.0], START, 15)
    truth = robot.history((-0.6,)).follow(*robot.drive.collars(joints)).position_m
    observer = robot.observer(NOISE_M)
    for q, tip in zip(joints, truth, strict=True):
        observer.observe(*robot.drive.collars(q), tip)
    return observer.state()


def test_predictions_start_from_what_is_known_and_promises_from_every_state() -> None:
    blind = scenario()
    seeing = blind.observed(followed_to_start(blind.robot))
    nothing, known = certify(blind, WAY), certify(seeing, WAY)
    assert nothing.start_friction == "unknown" and known.start_friction == "observed"
    for name in ("worst_bound_m", "goal_bound_m", "min_clearance_m", "min_stability", "cost_mm", "valid"):
        assert getattr(known, name) == getattr(nothing, name)
    assert known.goal_predicted_spread_m < 0.2 * nothing.goal_predicted_spread_m
    assert not known.recheck().differences


def test_the_prediction_is_where_the_robot_goes() -> None:
    case = scenario()
    robot, state = case.robot, followed_to_start(case.robot)
    joints = np.linspace(START - [0.0, 0.7, 0.0], START, 15)
    truth = robot.history((-0.6,)).follow(*robot.drive.collars(np.vstack([joints, WAY[1:]]))).position_m[-1]
    certificate = certify(case.observed(state), WAY)
    assert np.linalg.norm(certificate.goal_predicted_tip_m - truth) < 2 * NOISE_M


def test_on_another_mesh_friction_starts_at_its_average() -> None:
    robot = scenario().robot
    histories = followed_to_start(robot).histories
    coarse, fine = (predict(robot, WAY, histories, mesh).tip_m[:, -1] for mesh in ("search", "certificate"))
    np.testing.assert_allclose(coarse, fine, atol=1e-3)


def test_plan_takes_the_state_and_its_files_say_that_they_lack_it(tmp_path: Path) -> None:
    case = load_scenario(SCENARIOS / "pair_free.toml", ["planner.time_s=0.5"])
    observer = case.robot.observer(NOISE_M)
    observer.observe(*case.robot.drive.collars(case.start))
    plan = ctrplan.plan(case, start_state=observer.state())
    assert (
        plan.certificate.start_friction == "observed" and plan.to_json()["certificate"]["start_friction"] == "observed"
    )
    write_plan_json(tmp_path / "plan.json", plan)
    write_trajectory(tmp_path, plan.trajectory, trajectory_formats(["csv"]))
    written = load_plan(tmp_path / "plan.json", case.path, allow_outside=True)
    with pytest.raises(CtrplanError, match="an observer's state, which no file holds"):
        recomputed_differences(written)
    files, here = verify(written, work=2000), verify(plan, work=2000)
    assert files.is_kept and "which no file holds" in files.unchecked  # once the certificate did not hold
    assert here.is_kept and not here.unchecked and not recomputed_differences(WrittenPlan.of(plan))


def test_what_friction_can_not_explain_is_missed_whatever_an_observer_knew() -> None:
    """Where a plan's start is lost, its tip may be off by what it corrects for, which the bound limits."""
    robot = load_robot(ROBOTS / "table_5_pair.toml")
    case = load_scenario(SCENARIOS / "pair_free.toml", ["planner.time_s=0.3"])
    tip_m = robot.solve(*robot.drive.collars(case.start + [0, 0.4, 0])).tip_m
    case = case.with_(goal=ctrplan.Goal(tip_m=tip_m, tolerance_m=0.1e-3))
    observer = case.robot.observer(NOISE_M)
    observer.observe(*case.robot.drive.collars(case.start))
    plan = ctrplan.plan(case, start_state=observer.state())
    lost = replace(WrittenPlan.of(plan), scenario=case)
    assert not broken_promises(lost)
    moved = case.goal.tip_m + [0, 0, 2 * plan.certificate.goal_bound_m + 1e-3]
    elsewhere = replace(case, goal=replace(case.goal, tip_m=moved))
    assert "mm from the target" in broken_promises(replace(lost, scenario=elsewhere))[0]


def test_a_scenario_file_can_not_name_what_it_does_not_hold() -> None:
    with pytest.raises(InputError, match="start.friction = 'observed': must be one of unknown, oscillated, released"):
        load_scenario(SCENARIOS / "pair_free.toml", ["start.friction=observed"])


def test_a_state_of_another_robot_or_place_is_refused() -> None:
    case = scenario()
    state = followed_to_start(case.robot)
    other = load_robot(ROBOTS / "table_5_pair.toml", ["contact.1.clearance_mm=0.06"])
    with pytest.raises(InputError, match="start_state: is of another robot"):
        ctrplan.plan(replace(case, robot=other), start_state=state)
    with pytest.raises(InputError, match="start_state: stands at other joints"):
        ctrplan.plan(replace(case, start=START + 0.1), start_state=state)
    with pytest.raises(InputError, match="must be a ObserverState"):
        ctrplan.plan(case, start_state="known")  # type: ignore[arg-type]
