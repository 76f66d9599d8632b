"""Descent of goal states: exact slopes against differences, and what every trail must keep."""

from __future__ import annotations

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import descended, goal_states
from ctrplan.planning.reach import bound_slopes
from ctrplan.scenario.tip_solver import GoalState

STEEP = "goal={tip_mm=[16.1, -30.3, 144.9], tolerance_mm=1.0}"  # where descent pays


def checker_of(name: str, *overrides: str) -> MotionChecker:
    return MotionChecker(load_scenario(SCENARIOS / f"{name}.toml", list(overrides)))


@pytest.fixture(scope="module")
def steep() -> tuple[MotionChecker, list[GoalState]]:
    checker = checker_of("deploy", STEEP)
    return checker, goal_states(checker, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["vessel", "deploy"])
def test_slopes_are_those_of_the_bound(name: str) -> None:
    checker, step = checker_of(name), 1e-4
    q = checker.space.sample(np.random.default_rng(2), 40)
    q = q[checker.mechanics.bound_many(*checker.space.drive.collars(q)).stability > 0.3][:6]
    slopes, compared = bound_slopes(checker, q), 0

    def bound_m(joints: np.ndarray) -> float:
        return float(checker.mechanics.bound(*checker.space.drive.collars(joints)).position_m)

    for k, row in enumerate(q):
        for j in range(len(row)):
            ends = row + step * np.array([[1.0], [-1.0]]) * (np.arange(len(row)) == j)
            if checker.space.allowed(ends):
                difference = (bound_m(ends[0]) - bound_m(ends[1])) / (2 * step)
                # derivatives of the discretised equations leave out that the coarse mesh moves with the tubes' ends
                near = {"rel": 1e-4, "abs": 1e-6} if checker.space.drive.is_rotation[j] else {"rel": 0.2, "abs": 0.02}
                assert slopes.bound_by[k, j] == pytest.approx(difference, **near)
                compared += 1
    assert compared > 12


def test_trails_lead_down_and_stay_on_the_target(steep: tuple[MotionChecker, list[GoalState]]) -> None:
    checker, goals = steep
    target_m = checker.scenario.goal.tip_m
    trails = descended(checker, goals)
    assert len(trails) > len(goals) / 2
    assert min(trail[-1].bound_m for trail in trails) < 0.5 * goals[0].bound_m
    for trail in trails:
        assert any(trail[0] is goal for goal in goals)
        bounds = [state.bound_m for state in trail]
        assert np.all(np.diff(bounds) < 0)
        for state in trail[1:]:
            exact = checker.mechanics.bound(*checker.space.drive.collars(state.joints))
            assert exact.position_m == pytest.approx(state.bound_m, rel=1e-6)
            tip_m = checker.scenario.base_R @ exact.frictionless.centreline_m[-1] + checker.scenario.base_position_m
            assert np.linalg.norm(tip_m - target_m) <= checker.scenario.goal.tolerance_m
            assert checker.state(state.joints).valid


def test_a_direction_asked_for_is_kept(steep: tuple[MotionChecker, list[GoalState]]) -> None:
    free, goal = steep[0], steep[1][0]
    samples = free.probe(goal.joints)[1]
    assert samples is not None
    direction = [round(float(x), 6) for x in free.scenario.base_R @ samples.tip_tangent[-1]]
    tip_mm = [
        round(float(x) * 1e3, 6) for x in free.scenario.base_R @ samples.tip_m[-1] + free.scenario.base_position_m
    ]
    asked = f"goal={{tip_mm={tip_mm}, tolerance_mm=1.0, direction={direction}, direction_tolerance_deg=5.0}}"
    checker = checker_of("deploy", asked)
    trails = descended(checker, [goal])
    assert trails and trails[0][-1].bound_m < goal.bound_m
    for state in trails[0][1:]:
        samples = checker.probe(state.joints)[1]
        assert samples is not None
        turned = checker.scenario.base_R @ samples.tip_tangent[-1] @ np.array(direction)
        assert np.degrees(np.arccos(min(1.0, turned))) <= 5.0 + 1e-6


def test_nothing_to_descend() -> None:
    spare_none = checker_of("pair_free")  # three joints for three coordinates of the tip
    assert descended(spare_none, goal_states(spare_none, np.random.default_rng(0))) == []
    at_joints = checker_of("snap")
    assert at_joints.scenario.goal.joints is not None
    assert descended(at_joints, goal_states(at_joints, np.random.default_rng(0))) == []
