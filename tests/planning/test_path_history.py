"""Planning with path history: what is predicted, what settles and compensates, and which order leaves least error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_input import thorough
from places import SCENARIOS

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import certify
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.shapes import LONG_STEPS
from ctrplan.motion.checker import COEFFICIENTS, MotionChecker
from ctrplan.planning.compensate import compensate, corrected
from ctrplan.planning.endings import SHAPE, Settled, oscillation, settle, turnings
from ctrplan.planning.reordering import (
    as_given,
    assemble,
    least_error_order,
    translations_first,
    with_translation_last,
)
from ctrplan.plans.plan import Plan
from ctrplan.scenario.prediction import (
    TIP_TOLERANCE_M,
    end_tips,
    predict,
    predict_end,
    predict_from,
    start_states,
)
from ctrplan.scenario.scenario import Goal, Scenario

START = np.array([0.0, 0.0, -0.03])
GOAL = np.array([1.0, 3.2, 0.02])  # of the pair: friction moves its tip by 5 mm
TURN_FIRST = np.array([START, [GOAL[0], GOAL[1], START[2]], GOAL])


def pair(*overrides: str) -> Scenario:
    return load_scenario(SCENARIOS / "pair_free.toml", overrides)


@pytest.fixture(scope="module")
def checker() -> MotionChecker:
    return MotionChecker(pair())


@pytest.fixture(scope="module")
def turned_last(checker: MotionChecker) -> Array:
    return translations_first(checker, TURN_FIRST)


@pytest.fixture(scope="module")
def reordered(turned_last: Array) -> Plan:
    case = pair()
    return ctrplan.reorder(turned_last, replace(case, goal=replace(case.goal, joints=GOAL)))


def test_rotations_first_leave_a_fraction_of_what_translations_first_leave(reordered: Plan) -> None:
    error = {other.name: other.goal_predicted_m for other in reordered.reorder.alternatives}
    assert error["as given"] == error["translations first"] > 20 * error["as driven"]
    assert error["as driven"] < error["straight line"]
    assert [leg.kind for leg in reordered.legs] == ["rotation", "translation"]
    assert any("became 2 legs (rotation, translation)" in change for change in reordered.reorder.changes)
    assert reordered.certificate.goal_predicted_m == pytest.approx(error["as driven"], abs=1e-5)


def test_predicted_error_stays_below_the_worst_case(reordered: Plan) -> None:
    samples = reordered.certificate.samples
    assert np.all(samples.released_m <= samples.bound_m + 1e-12)
    assert np.all(samples.predicted_m <= samples.bound_m * 1.01 + 0.05e-3)
    assert samples.predicted_m[-1] < 0.05 * samples.bound_m[-1]  # translation releases what rotation loaded
    assert samples.predicted_m[samples.leg == 0][-1] > 0.5 * samples.bound_m[samples.leg == 0][-1]


def test_prediction_is_the_history_of_every_start() -> None:
    robot = pair().robot
    whole = predict(robot, TURN_FIRST, start_states(pair()))
    for tips, start in zip(whole.tip_m, ["released", (1.0,), (-1.0,)], strict=True):
        history = robot.history(start)
        for q in TURN_FIRST:
            step = history.advance(*robot.drive.collars(q))
        np.testing.assert_allclose(tips[-1], step.shape.tip_m, atol=1e-9)
    _, states = predict_end(robot, TURN_FIRST[:2], start_states(pair()))
    np.testing.assert_allclose(predict_from(robot, states, TURN_FIRST[1:]).tip_m[:, -1], whole.tip_m[:, -1], atol=5e-5)


def test_a_search_simulates_what_a_plan_is_certified_by_in_fewer_steps() -> None:
    """Tips of both are alike to what histories are simulated to, and a path costs the search fewer steps."""
    case = load_scenario(SCENARIOS / "sinus.toml")
    robot, starts, rng = case.robot, start_states(case), np.random.default_rng(0)
    for _ in range(3):
        turned, slid = np.array([0.4, -0.5, 0.6, 0, 0]), np.array([0, 0, 0, 0.01, 0.02])
        steps = [turned * rng.uniform(-1, 1, 5), slid * rng.uniform(0.3, 1, 5)]
        path = np.vstack([case.start, case.start + np.cumsum(steps, axis=0)])
        exact = predict(robot, path, starts).tip_m[:, -1]
        np.testing.assert_allclose(end_tips(robot, path, starts), exact, atol=TIP_TOLERANCE_M)
        counts = []
        for options in (None, LONG_STEPS):
            history = robot.history(options=options)
            counts.append(sum(history.advance(*robot.drive.collars(q)).steps for q in path))
        assert counts[1] < 0.7 * counts[0]


def test_search_pays_for_what_no_slip_erases(checker: MotionChecker, turned_last: Array) -> None:
    """A short turn leaves most of what friction was before, a long one or a slide next to nothing.

    Of what is known, coefficients leave a share unknown; joint values are driven to as they are, with all of it.
    """
    short = checker.along(np.array([GOAL - [0.0, 0.02, 0.0], GOAL]))
    assert 0.9 * short.end_bound_m < short.end_error_m <= short.end_bound_m
    turned, slid = (checker.along(erasing) for erasing in (turned_last, TURN_FIRST))
    assert turned.end_error_m == pytest.approx(turned.end_bound_m, rel=0.01)  # loaded
    to_a_tip = MotionChecker(replace(pair(), goal=Goal(None, np.array([0.0, 0.0, 0.1]), 1e-3)))
    assert to_a_tip.along(turned_last).end_error_m == pytest.approx(COEFFICIENTS * turned.end_bound_m, rel=0.01)
    assert slid.end_error_m < 1e-3 * slid.end_bound_m
    assert checker.cost_mm(slid, ends_at_goal=True) < checker.cost_mm(turned, ends_at_goal=True)


def test_rotation_alone_is_driven_from_a_retreat(checker: MotionChecker) -> None:
    path = np.array([GOAL - [0, 0.2, 0], GOAL])
    ways = with_translation_last(checker, path)
    assert ways and all(np.array_equal(way[0], path[0]) and np.array_equal(way[-1], path[-1]) for way in ways)
    assert with_translation_last(checker, TURN_FIRST) == []  # ends with a long translation anyway
    result = least_error_order(checker, path)
    assert result.motion_after.end_error_m < 0.1 * result.motion_before.end_error_m
    assert len(result.after) == 4 and checker.space.allowed(result.after)
    blind = MotionChecker(pair("cost.error_goal=0", "cost.error_along=0"))
    np.testing.assert_array_equal(least_error_order(blind, path).after, path)


def test_oscillation_turns_neighbours_against_each_other_and_comes_back(checker: MotionChecker) -> None:
    drive = checker.space.drive
    for turn in turnings(drive):
        np.testing.assert_allclose(np.abs(np.diff(drive.matrix_theta @ turn)), 1)
        assert not turn[~drive.is_rotation].any()
        rows = oscillation(GOAL, 0.7 * turn)
        np.testing.assert_array_equal(rows[-1], GOAL)
        np.testing.assert_allclose(rows - GOAL, 0.7 * SHAPE[:, None] * turn, atol=1e-12)
    np.testing.assert_allclose(SHAPE[:4] * 40, [40, -38, 36, -34])  # Section V-A


@pytest.fixture(scope="module")
def loaded(checker: MotionChecker, turned_last: Array) -> Certificate:
    """The certificate of the path that leaves friction at the goal."""
    return certify(checker.scenario, turned_last)


@pytest.fixture(scope="module")
def settled(checker: MotionChecker, turned_last: Array, loaded: Certificate) -> Settled:
    """The turned path with an oscillation appended at its end."""
    return settle(checker, turned_last, loaded)


def test_settling_releases_a_loaded_goal(loaded: Certificate, settled: Settled, turned_last: Array) -> None:
    before = loaded
    settling = settled.certificate.settling
    assert settling is not None and settled.certificate.valid and not settled.note
    assert settling.goal_predicted_before_m == before.goal_predicted_m > 4e-3
    assert settling.goal_predicted_after_m < 0.2 * before.goal_predicted_m
    assert settling.first_leg == 2 and len(settled.corners) == 3 + len(SHAPE)
    np.testing.assert_array_equal(settled.corners[-1], turned_last[-1])
    assert settled.certificate.goal_bound_m == pytest.approx(before.goal_bound_m)  # no history changes the worst case


@thorough("test_settling_releases_a_loaded_goal")
def test_settling_that_would_load_friction_is_left_out(checker: MotionChecker) -> None:
    released = certify(checker.scenario, TURN_FIRST)
    settled = settle(checker, TURN_FIRST, released)
    assert settled.certificate is released and "left out" in settled.note
    assert settled.corners is TURN_FIRST


def test_compensation_brings_the_predicted_tip_to_the_target(turned_last: Array) -> None:
    robot = pair().robot
    target = robot.solve(*robot.drive.collars(GOAL)).tip_m * 1e3
    case = pair(f"goal={{tip_mm={target.round(3).tolist()}, tolerance_mm=1}}")
    checker = MotionChecker(case)
    before = certify(case, turned_last)
    result = compensate(checker, turned_last, before)
    corners, after, compensation = result.corners, result.certificate, result.compensation
    assert after.valid and not compensation.note
    assert after.arrival is not None and after.arrival.by_cause.offset_m < 0.02e-3
    assert compensation.error_without_m > 4e-3 and compensation.error_with_m < 0.25e-3  # execution and mesh count
    end = predict(robot, corners, start_states(case)).tip_m[:, -1]
    np.testing.assert_allclose(end, np.broadcast_to(target * 1e-3, end.shape), atol=0.15e-3)
    assert after.goal_tip_error_m <= after.goal_bound_m  # the target stays inside the worst-case envelope
    np.testing.assert_allclose(corners[-1] - turned_last[-1], compensation.correction, atol=1e-12)


def test_what_settling_changed_is_what_is_compared(
    checker: MotionChecker, turned_last: Array, settled: Settled
) -> None:
    given = as_given(checker, turned_last)
    plan = assemble(
        checker.scenario,
        [given],
        settled.certificate,
        planner="given path",
        seed=0,
        clock_s=0.0,
        ends=[settled.corners],
    )
    ways = {other.name: other for other in plan.reorder.alternatives}
    assert ways["as driven"].problem == next(iter(plan.certificate.problems), "")  # never "not valid" beside it
    assert ways["as driven"].length_mm == pytest.approx(plan.certificate.length_mm)
    assert ways["as driven"].goal_predicted_m == pytest.approx(plan.certificate.goal_predicted_m, abs=0.05e-3)
    assert ways["as given"].goal_predicted_m == pytest.approx(settled.certificate.settling.goal_predicted_before_m)


def test_correction_keeps_the_kinds_of_legs() -> None:
    kind = np.array([True, True, False])
    moved = corrected(TURN_FIRST, 2, kind, np.array([0.1, -0.2, 0.001]))
    np.testing.assert_allclose(moved, [START, [1.1, 3.0, START[2]], [1.1, 3.0, 0.021]])
    alone = corrected(TURN_FIRST[:2], 1, kind, np.array([0.0, 0.0, 0.001]))
    np.testing.assert_allclose(np.diff(alone, axis=0), [[1.0, 3.2, 0], [0, 0, 0.001]], atol=1e-12)


def test_a_goal_in_joint_values_is_driven_to_as_it_is() -> None:
    plan = ctrplan.plan(pair("planner.time_s=0.2"))
    assert plan.compensation is None
    turned = plan.waypoints[-1] - plan.scenario.goal.joints
    np.testing.assert_allclose(turned / np.array([2 * np.pi, 2 * np.pi, 1]), np.round(turned / 2 / np.pi), atol=1e-9)


def test_what_is_known_of_the_start_lowers_predictions_and_no_bound() -> None:
    """[start] friction: a released start is one of the unknown ones; the bound asks no history."""
    found = {}
    for friction in ("unknown", "oscillated", "released"):
        case = pair(f'start.friction="{friction}"')
        assert case.start_friction == friction
        certificate = certify(case, TURN_FIRST[:2])
        assert certificate.start_friction == friction
        found[friction] = certificate.samples
    for known in ("oscillated", "released"):
        np.testing.assert_array_equal(found[known].bound_m, found["unknown"].bound_m)
        np.testing.assert_array_equal(found[known].clearance_m, found["unknown"].clearance_m)
        assert np.all(found[known].released_m <= found["unknown"].released_m + 1e-12)
        assert found[known].predicted_m[0] < 0.1 * found["unknown"].predicted_m[0]
    assert found["released"].predicted_m[0] < 1e-5 and found["released"].released_m[0] == 0
    assert np.all(found["released"].predicted_m <= found["unknown"].predicted_m + 0.1e-3)
    with pytest.raises(InputError, match="start.friction.*must be one of unknown, oscillated, released"):
        pair('start.friction="gone"')
