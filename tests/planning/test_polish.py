"""Local improvement of a path: what it goes down by, what it keeps, and that it never gets dearer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.drive.legs import merge_legs
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.compensate import CLOSE_M, aimed, brought_to_goal
from ctrplan.planning.goal_states import goal_state
from ctrplan.planning.search.polish import Polish
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.prediction import predict_end, start_states
from ctrplan.scenario.scenario import CostTerm, Goal, Scenario

START, GOAL = np.radians([0, 0, 0, 0]), np.append(np.radians([20.0, 80.0, 130.0]), -20e-3)
START[3] = -60e-3


@pytest.fixture(scope="module")
def case() -> Scenario:
    """Three tubes in free space, whose goal is a tip: four joints leave one to spare."""
    bare = bare_scenario(load_scenario(SCENARIOS / "vessel.toml").robot)
    tip = bare.robot.solve(*bare.robot.drive.collars(GOAL)).tip_m
    return replace(bare, start=START, goal=Goal(None, tip, 1e-3), anatomy=())


@pytest.fixture(scope="module")
def checker(case: Scenario) -> MotionChecker:
    return MotionChecker(case)


def roundabout() -> Array:
    """Legs of either kind by turns, with detours."""
    rotations = np.radians([[0, 0, 0], [50, 20, -30], [-20, 90, 60], [20, 80, 130]])
    corners = [START]
    for turn, l_m in zip(rotations[1:], (-45e-3, -30e-3, -20e-3), strict=True):
        corners += [np.append(turn, corners[-1][3]), np.append(turn, l_m)]
    return np.array(corners)


def test_derivatives_are_those_of_length_and_worst_case(case: Scenario, checker: MotionChecker) -> None:
    """Each by differences of the whole path's price: the length alone inside, the bound at the goal beside it."""
    plain = replace(case, cost=replace(case.cost, error_along=0.0))
    polish = Polish(MotionChecker(plain), roundabout(), 0)
    levels = polish._levels()
    assert [(level.first, level.last) for level in levels] == [(1, 3), (3, 5), (2, 4), (4, 6), (5, 7)]

    def price(corners: Array) -> float:
        length = sum(polish.space.length_mm(d) for d in np.diff(corners, axis=0))
        goal = polish.checker.mechanics.bound(*polish.space.drive.collars(corners[-1])).position_m
        return plain.cost.path * length + plain.cost.error_goal * MM_PER_M * goal

    for level in levels:
        is_goal = level.last == len(polish.corners)
        slope = sum(polish._pull(kind, level) for kind in polish._kinds(level))
        slope = np.asarray(slope) + (polish._goal_error(level) if is_goal else 0.0)
        for joint in np.flatnonzero(level.joints).tolist():
            ends = []
            for h in (1e-5, -1e-5):
                corners, kind = polish.corners.copy(), polish.space.drive.is_rotation
                kind = kind if kind[joint] else ~kind
                first = polish._begin(kind) if is_goal else level.first
                corners[first : level.last, joint] += h
                ends.append(price(corners))
            by = (ends[0] - ends[1]) / 2e-5 / polish.space.weights_mm[joint]
            assert slope[joint] == pytest.approx(by, rel=1e-4, abs=1e-4)


def test_a_roundabout_way_gets_shorter_and_ends_at_the_target(case: Scenario, checker: MotionChecker) -> None:
    polish = Polish(checker, roundabout(), 0)
    before, costs = polish.cost_mm, [polish.cost_mm]

    def is_over() -> bool:
        costs.append(polish.cost_mm)
        return len(costs) > 300

    polish.run(is_over)
    assert costs == sorted(costs, reverse=True) and polish.cost_mm < 0.8 * before
    assert len(polish.corners) < len(roundabout()) and np.array_equal(polish.corners, merge_legs(polish.corners))
    np.testing.assert_array_equal(polish.corners[0], START)
    assert np.isfinite(goal_state(checker, polish.corners[-1]).bound_m)
    motion = checker.along(polish.corners)
    assert motion.valid and checker.cost_mm(motion, ends_at_goal=True) == pytest.approx(polish.cost_mm)


def test_a_goal_of_joints_or_of_another_s_choice_stays(case: Scenario, checker: MotionChecker) -> None:
    fixed = Polish(MotionChecker(replace(case, goal=Goal(GOAL, None, 1e-3))), roundabout(), 0)
    chosen = Polish(checker, roundabout(), 0, moves_goal=False)
    for polish in (fixed, chosen):
        turns = iter(range(60))
        polish.run(lambda turns=turns: next(turns, None) is None)  # type: ignore[misc]
        np.testing.assert_array_equal(polish.corners[-1], GOAL)


def test_a_path_that_is_over_at_once_stays_as_it_is(checker: MotionChecker) -> None:
    polish = Polish(checker, roundabout(), 0)
    polish.run(lambda: True)
    np.testing.assert_array_equal(polish.corners, merge_legs(roundabout()))


def test_a_path_is_polished_where_compensation_will_bring_it(case: Scenario, checker: MotionChecker) -> None:
    """The tip with friction arrives from there, the frictionless one from where it is brought back to."""
    robot, target = case.robot, case.goal.tip_m
    assert target is not None
    path = roundabout()[:-1]  # ends with a turn, which leaves friction
    path[-1] = GOAL
    other, moved = aimed(checker, path)

    def off_mm(corners: Array) -> float:
        middle = predict_end(robot, corners, start_states(case))[0].end_middle_m
        return float(np.linalg.norm(middle - target)) * MM_PER_M

    assert other is not checker and off_mm(path) > 0.2 and off_mm(moved) < 0.2 * off_mm(path)
    back = brought_to_goal(checker, moved)
    assert back is not None
    tip = robot.mechanics.tips_with_friction(*robot.drive.collars(back[-1:]), np.zeros((1, robot.n - 1))).position_m[0]
    assert np.linalg.norm(tip - target) < CLOSE_M
    to_joints = MotionChecker(replace(case, goal=replace(case.goal, tip_m=None, joints=GOAL)))
    assert aimed(to_joints, path) == (to_joints, path)


TURNED = CostTerm("turned", 100.0, lambda q: np.abs(q[:, 1]))
WITHDRAWN = CostTerm("withdrawn", 1e4, lambda q: GOAL[3] - q[:, 3])


@pytest.mark.parametrize("term", [TURNED, WITHDRAWN])
def test_legs_are_divided_where_that_pays(case: Scenario, term: CostTerm) -> None:
    """Half of a turn follows an insertion during which it is dear; half of an insertion precedes a turn alike."""
    bare = replace(case, goal=Goal(GOAL, None, 1e-3), cost=replace(case.cost, error_along=0.0))
    path = np.array([START, np.append(GOAL[:3], START[3]), GOAL])
    whole, divided = Polish(MotionChecker(bare), path, 0), Polish(MotionChecker(replace(bare, terms=(term,))), path, 0)
    before_mm = divided.cost_mm
    for polish in (whole, divided):
        turns = iter(range(2))  # nothing can be left out: the first steps divide
        polish.run(lambda turns=turns: next(turns, None) is None)  # type: ignore[misc]
    np.testing.assert_array_equal(whole.corners, path)
    assert divided.cost_mm < before_mm and len(divided.corners) == 5
    is_turned, is_slid = (np.diff(divided.corners, axis=0) != 0)[:, [1, 3]].T
    assert np.array_equal(is_turned, ~is_slid)
    np.testing.assert_array_equal(divided.corners[[0, -1]], path[[0, -1]])


def test_new_legs_are_those_that_changed(checker: MotionChecker) -> None:
    polish = Polish(checker, roundabout(), 0)
    for rows in ([2], [2, 3], [5], list(range(1, 7))):
        moved = polish.corners.copy()
        moved[rows, :] += 1e-3
        np.testing.assert_array_equal(polish._new_legs(moved), moved[rows[0] - 1 : rows[-1] + 2])
    shorter = np.delete(polish.corners, 3, axis=0)
    np.testing.assert_array_equal(polish._new_legs(shorter), shorter[2:4])
