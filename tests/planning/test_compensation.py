"""Compensation: how paths are corrected so that the middle of their arrivals is at the target."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from arriving_pair import GOAL, PATH, START, TURNED_LAST, certified, pair
from made_up_input import FUZZ
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.certificate.certify import certify
from ctrplan.certificate.walked_legs import walk_legs
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning import compensate as compensation
from ctrplan.planning.compensate import Compensated, _CorrectedEnd, compensate
from ctrplan.scenario import prediction
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.prediction import TIP_TOLERANCE_M, predict, start_states
from ctrplan.scenario.tip_solver import target_in_robot_frame
from ctrplan.storage.toml_document import read_document


def test_corrections_change_the_last_legs_or_add_two() -> None:
    turns, delta = np.array([True, True, False]), np.array([0.1, -0.2, 0.001])
    within, added = _CorrectedEnd(PATH, 2), _CorrectedEnd(PATH, 2, of_its_own=True)
    np.testing.assert_allclose(within.path(turns, delta)[-1], GOAL + delta)
    assert len(within.path(turns, delta)) == len(PATH) and within.unchanged(turns) == 0
    longer = added.path(turns, delta)
    np.testing.assert_array_equal(longer[: len(PATH)], PATH)
    np.testing.assert_allclose(np.diff(longer, axis=0)[-2:], [[0.1, -0.2, 0], [0, 0, 0.001]], atol=1e-12)
    assert added.unchanged(turns) == len(PATH) - 1 and len(added.path(turns, 0 * delta)) == len(PATH)


def test_steps_of_a_correction_keep_the_tubes_nested() -> None:
    """Where the bases of two tubes that slide on their own touch, neither goes into the other, wherever the aim is."""
    three = read_document(ROBOTS / "three_tube.toml").content
    curved = {"length_mm": 80, "curvature_x_per_m": 0, "curvature_y_per_m": 6}
    innermost = {
        **{"outer_diameter_mm": 1.5, "inner_diameter_mm": 1.2, "bending_stiffness_Nm2": 0.007, "poisson_ratio": 0.3},
        **{"collar_length_mm": 17, "section": [{**curved, "length_mm": 240, "curvature_y_per_m": 0}, curved]},
    }
    joints = [{**joint, "moves": {k: [*v, 0] for k, v in joint["moves"].items()}} for joint in three["joint"]]
    joints += [{"name": "turn the innermost", "moves": {"theta": [0, 0, 0, 1]}}]
    joints += [{"name": "slide the innermost", "moves": {"l": [0, 0, 0, 1]}, "min_mm": -80, "max_mm": 0}]
    parts = {"tube": [*three["tube"], innermost], "contact": [*three["contact"], {"friction_coefficient": 0.2}]}
    robot = robot_from_dict({**three, **parts, "joint": joints, "home": {"l_mm": [0, -17, -34, -51]}})
    checker = MotionChecker(bare_scenario(robot))
    (slope, room), rng = checker.space.nesting_rules, np.random.default_rng(0)
    touching = int(np.argmax((slope[:, 3] < 0) & (slope[:, 5] > 0)))
    for q in checker.space.sample(rng, 20):
        q[5] += room[touching] - slope[touching] @ q
        if checker.space.allowed(q):
            step = compensation._newton_step(checker, q, rng.normal(size=3) * 1e-3, None, np.ones(6, dtype=bool))
            assert step.any() and checker.space.allowed(q + step)


@pytest.mark.skipif(not FUZZ, reason="a plan of a patient's size, of which benchmarks have a table: make fuzz")
def test_a_correction_keeps_clear_of_what_stands_beside_the_way() -> None:
    """A body beside the last leg leaves no room for the leg to be moved: legs of their own at the end do it."""
    scenario = load_scenario(SCENARIOS / "ventricle.toml")
    plan = ctrplan.plan(scenario)
    found = plan.certificate.arrival
    assert found is not None and found.by_cause.offset_m < TIP_TOLERANCE_M and plan.certificate.min_clearance_m >= 0


def test_what_the_first_correction_leaves_is_corrected_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the first round can make but half of every correction, the second makes half of the rest."""
    ways = compensation._corrected_ways

    def halves(*given: Any) -> Any:
        for way in ways(*given):
            if not way.is_whole:
                yield way
                return

    case, before = pair(), certified(TURNED_LAST)
    case = replace(case, goal=replace(case.goal, tolerance_m=4e-3))  # of which its arrival knows nothing
    monkeypatch.setattr(compensation, "_corrected_ways", halves)
    result = compensate(MotionChecker(case), TURNED_LAST, before)
    found, at_first = result.certificate.arrival, before.arrival
    assert found is not None and at_first is not None and at_first.by_cause.offset_m > 0.2e-3
    assert found.by_cause.offset_m < 0.35 * at_first.by_cause.offset_m
    np.testing.assert_allclose(result.corners[-1] - GOAL, result.compensation.correction, atol=1e-12)


@cache
def compensated() -> Compensated:
    """The pair's path that ends with a turn, corrected; nobody changes it."""
    return compensate(MotionChecker(pair()), TURNED_LAST, certified(TURNED_LAST))


def test_the_way_that_is_known_to_be_driven_is_tried_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is corrected or walked where it is certified and arrives; else corrections follow."""
    case, before, found = pair(), certified(TURNED_LAST), compensated()
    checker = MotionChecker(case)
    assert np.any(found.corners != TURNED_LAST)
    in_vain = compensate(checker, TURNED_LAST, before, walk_legs(case, TURNED_LAST + [0, 1e-6, 1e-6]))
    np.testing.assert_array_equal(in_vain.corners, found.corners)
    driven = walk_legs(case, found.corners)
    monkeypatch.setattr(compensation, "_correction", None)
    monkeypatch.setattr(compensation, "walk_legs", None)
    known = compensate(checker, TURNED_LAST, before, driven)
    np.testing.assert_array_equal(known.corners, found.corners)
    np.testing.assert_allclose(known.compensation.correction, found.compensation.correction, atol=1e-12)


def test_a_path_that_a_search_moved_is_brought_on_target_by_histories_of_ordinary_steps() -> None:
    case = pair()
    checker, delta = MotionChecker(case), np.array([0.0, 0.003, 0.0004])
    path = compensation.on_target(
        checker, compensate(checker, PATH, certify(case, PATH)).corners + delta * [[0], [1], [1]]
    )
    middle = predict(case.robot, path, start_states(case)).end_middle_m
    assert np.linalg.norm(middle - target_in_robot_frame(case)) < compensation.CLOSE_M


@pytest.mark.parametrize("slope", [0.13, -1.05, -0.9, 0.5])
def test_the_offset_that_is_aimed_for_is_that_at_the_end(slope: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it changes as much as the end does, so that aiming where it last was leads away."""
    case, path = pair(), TURNED_LAST

    def miss_m(corners: Any) -> Any:
        return compensation.frictionless_tips(case.robot, corners[-1:])[0][0] - case.goal.tip_m

    def offset_m(_: Any, corners: Any, beside: Any = None) -> Any:
        return np.array([0.3e-3, -0.1e-3, 0.2e-3]) + slope * miss_m(corners)

    monkeypatch.setattr(compensation, "offset_m", offset_m)
    checker = MotionChecker(case)
    other, moved = compensation.aimed(checker, path)
    assert other is not checker and np.linalg.norm(miss_m(moved)) > 0.1e-3
    assert np.linalg.norm(miss_m(moved) + offset_m(None, moved)) < 2 * compensation.CLOSE_M


def test_a_line_gets_corners_where_friction_takes_the_tip_off_between_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that begins with a reversal: friction builds up, and the tip does not follow the joints in proportion."""
    case, corners = pair(), np.linspace(GOAL, GOAL - [0.0, 0.4, 0.01], 3)
    robot, start = case.robot, [(1.0,)]
    tips = [robot.solve(*robot.drive.collars(q)).tip_m for q in corners]
    tips[0] = predict(robot, corners[:1], start).tip_m[0, 0]
    case = replace(case, start=GOAL, goal=replace(case.goal, tip_m=tips[-1], line_m=np.array(tips)))
    checker, certificate = MotionChecker(case), certify(case, corners)
    line, worst = compensation._line(checker, corners), list[float]()
    for most in (compensation.ROUNDS, 0):
        monkeypatch.setattr(compensation, "ROUNDS", most)
        whole, moved = compensation._corrected_line(checker, corners, certificate, start)
        assert whole.shape == moved.shape and np.array_equal(moved[0], corners[0])
        fine = np.vstack([np.linspace(a, b, 20) for a, b in itertools.pairwise(moved)])
        worst.append(float(line.off_m(predict(robot, fine, start).tip_m[0], is_end=False).max()))
    assert worst[0] < worst[1] / 3


def test_what_joints_limits_leave_of_the_offset_is_said() -> None:
    """The tube that must move on stands at its stop: the rest, and what stops it, are told."""
    case = pair()
    joints = [
        replace(j, lower=min(a, b) - 1e-6, upper=max(a, b) + 1e-6)
        for j, a, b in zip(case.robot.drive.joints, START, GOAL, strict=True)
    ]
    stopped = replace(case, robot=replace(case.robot, drive=replace(case.robot.drive, joints=tuple(joints))))
    result = compensate(MotionChecker(stopped), TURNED_LAST, certify(stopped, TURNED_LAST))
    found = result.certificate.arrival
    assert found is not None and found.by_cause.offset_m > TIP_TOLERANCE_M
    assert result.compensation.note.startswith(f"{found.by_cause.offset_m * 1e3:.2f} mm of the known offset: ")
    assert "within the joints' limits" in result.compensation.note
    assert not compensated().compensation.note


def test_a_path_that_is_aimed_is_simulated_from_every_start_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before and after it is moved; on the way one start tells. Whoever asks for the end later waits for no history."""
    asked, simulate = list[tuple[bytes, int]](), prediction.end_tips

    def counted(robot: Any, corners: Any, starts: Any) -> Any:
        asked.append((corners.tobytes(), len(starts)))
        return simulate(robot, corners, starts)

    monkeypatch.setattr(prediction, "end_tips", counted)
    checker = MotionChecker(pair())
    starts = start_states(checker.scenario)
    there, moved = compensation.aimed(checker, PATH)
    assert there is not checker and len(asked) == len(set(asked)) > 2
    everywhere = [path for path, count in asked if count == len(starts)]
    assert everywhere == [PATH.tobytes(), moved.tobytes()] and {count for _, count in asked} == {1, len(starts)}
    ends = [prediction.end_middle_m(checker.scenario, path) for path in (PATH, moved)]
    assert len(asked) == len(set(asked))
    again = prediction.ball_centre(simulate(checker.scenario.robot, PATH, starts))
    np.testing.assert_allclose(ends[0], again, atol=1e-9)
    before = len(asked)
    beside, _ = compensation.aimed(checker, moved, PATH)
    assert beside is not checker and all(count == 1 for _, count in asked[before:])


@pytest.mark.parametrize("friction", ["unknown", "released"])
def test_one_start_tells_where_a_path_beside_a_simulated_one_ends(friction: str) -> None:
    """The less far off the nearer it is: by a share of what the starts differ by, by nothing where there is but one."""
    case, rng = load_scenario(SCENARIOS / "sinus.toml", [f"start.friction={friction}"]), np.random.default_rng(0)
    steps = [[0.1, -0.1, 0.2, 0, 0], [0, 0, 0, 0.01, 0.02], [0.1, -0.1, -0.1, 0, 0]]
    path = np.vstack([case.start, case.start + np.cumsum(steps, axis=0)])
    spread_m = prediction.predict(case.robot, path, start_states(case)).end_spread_m
    assert (spread_m > 0.1e-3) == (friction == "unknown")
    np.testing.assert_array_equal(*(prediction.end_middle_m(case, path, beside) for beside in (None, path)))
    for size in (0.3, 0.1, 0.03, 0.01):
        other = path + size * np.cumsum(np.diff(path, axis=0, prepend=path[:1]) * rng.normal(size=path.shape), axis=0)
        off = prediction.end_middle_m(case, other, path) - prediction.end_middle_m(case, other)
        assert np.linalg.norm(off) <= 5 * size * spread_m + 1e-12
        shift = prediction.offset_m(case, other, path) - prediction.offset_m(case, other)
        np.testing.assert_allclose(shift, off, atol=1e-12)
