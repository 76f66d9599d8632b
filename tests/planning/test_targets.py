"""Several targets in order, and lines to follow: each is reached, the drive rests there, and figures add up."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from places import SCENARIOS

import ctrplan
from ctrplan.audit.verify import recomputed_differences
from ctrplan.base.long_work import SearchClock
from ctrplan.certificate.certify import certify
from ctrplan.certificate.friction_states import bound_allowance_m
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.files.scenario_file import load_robot_or_scenario, scenario_from_dict
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.endings import settle
from ctrplan.planning.goal_states import follow_line, goal_states
from ctrplan.planning.search.ompl_set_up import SearchProblem
from ctrplan.planning.search.stage_search import Candidate, Progress, StageSearch
from ctrplan.plans.planned_motion import marked_trajectory, restarts
from ctrplan.reports.plan_words import restart_words
from ctrplan.scenario.prediction import predict, start_states
from ctrplan.scenario.scenario import Goal, Scenario

START = {"rotate outer": 0, "rotate inner": 0, "translate inner": -30}


def pair(**keys: object) -> Scenario:
    content = {"robot": "robots/table_5_pair.toml", "start": START, "planner": {"time_s": 0.5}, **keys}
    return scenario_from_dict(content, file=str(SCENARIOS / "case.toml"))


@pytest.fixture(scope="module")
def tour() -> ctrplan.Plan:
    first = {"name": "first", "tip_mm": [50, 10, 200], "tolerance_mm": 1}
    second = {"joints": {"rotate outer": 20, "rotate inner": 40, "translate inner": 10}}
    third = {"name": "third", "tip_mm": [45, -15, 205], "tolerance_mm": 1}
    return ctrplan.plan(pair(target=[first, second, third], planner={"time_s": 0.3}), seed=0)


def test_every_target_is_reached_in_order(tour: ctrplan.Plan) -> None:
    certificate, targets = tour.certificate, tour.certificate.targets
    assert certificate.valid and [t.name for t in targets] == ["first", "", "third"]
    robot = tour.scenario.robot
    for goal, reached in zip(tour.scenario.targets, targets, strict=True):
        end = tour.legs[reached.leg].end
        bound = robot.bound(*robot.drive.collars(end), accuracy="certificate")
        allowance = bound_allowance_m(robot, "certificate")
        assert bound.position_m + allowance == pytest.approx(reached.bound_m, abs=2e-5)
        if goal.tip_m is None:
            assert goal.joints is not None
            np.testing.assert_allclose(end, goal.joints, atol=1e-9)
        else:
            assert np.linalg.norm(bound.frictionless.tip_m - goal.tip_m) <= goal.tolerance_m
            assert reached.tip_error_m <= goal.tolerance_m
    assert [t.leg for t in targets] == sorted(t.leg for t in targets) and targets[-1].leg == len(tour.legs) - 1


def test_an_interrupted_tour_begins_again_for_the_target_that_it_was_on_its_way_to(tour: ctrplan.Plan) -> None:
    """Once the place for the last target was said alone, and whoever began again there left the others out."""
    robot, found = tour.scenario.robot, restarts(tour.certificate)
    marks = np.flatnonzero(marked_trajectory(tour).marks["restart"])
    assert len(found) == 3 and len(marks) == len(set(found))
    for number, (waypoint, target) in enumerate(zip(found, tour.certificate.targets, strict=True), start=1):
        assert waypoint is not None and waypoint <= target.leg and target.arrival is not None
        assert f"{waypoint} for target {number}" in restart_words(tour).replace("from the start", "0")
        tips = predict(robot, tour.waypoints[waypoint : target.leg + 2], start_states(tour.scenario)).tip_m[:, -1]
        assert np.linalg.norm(tips - target.arrival.middle_m, axis=1).max() < 1e-4
        assert np.abs(tour.waypoints[waypoint] - tour.trajectory.position[marks]).max(axis=1).min() < 1e-9


def test_friction_known_before_a_tour_is_known_before_its_first_target_alone() -> None:
    """Once whoever certified the way again took it for released at every target, and found the plan's figures wrong."""
    there, back = {**START, "rotate inner": 40}, {**START, "friction": "released"}
    case = pair(start=back, target=[{"joints": there}, {"joints": START}, {"joints": there}], planner={"time_s": 0.2})
    plan = ctrplan.plan(case)
    again = ctrplan.certify(case, plan.waypoints)
    assert again.released_integral_mm == pytest.approx(plan.certificate.released_integral_mm)
    assert not recomputed_differences(WrittenPlan.of(plan))


def test_a_target_is_passed_by_the_tip_that_friction_moves() -> None:
    """Once friction had to be nothing there: waypoints of plans that were corrected for it passed no target."""
    start = {**START, "friction": "released"}
    path = pair(start=start, goal={"joints": START}).start + np.array([[0, 0, 0], [0, 1.2, 0], [0, 1.2, 5e-3]])
    robot = pair(start=start, goal={"joints": START}).robot
    moved_m = predict(robot, path[:2], ["released"]).tip_m[0, -1]
    free_m = robot.solve(*robot.drive.collars(path[1])).tip_m
    targets = [{"tip_mm": (moved_m * 1e3).tolist(), "tolerance_mm": 0.1}, {"joints": {**START, "rotate inner": 0}}]
    case = pair(start=start, target=targets)
    case = case.with_(goal=Goal(joints=path[-1]))
    assert np.linalg.norm(moved_m - free_m) > 0.3e-3
    found = ctrplan.certify(case, path)
    assert found.valid and [target.leg for target in found.targets] == [0, 1]
    with pytest.raises(InputError, match=r"no waypoint is at target\.1\.tip_mm"):
        ctrplan.certify(case, path[[0, 2]])


def test_joints_are_planned_to_for_the_tip_that_they_are_meant_for() -> None:
    joints = {"rotate outer": 5, "rotate inner": 10, "translate inner": -27}
    there = pair(goal={"joints": joints})
    assert there.goal.joints is not None
    tip_m = there.robot.bound(*there.robot.drive.collars(there.goal.joints)).frictionless.tip_m

    def meant(off_mm: float) -> Scenario:
        tip_mm = (there.base_R @ tip_m + there.base_position_m) * 1e3 + [off_mm, 0, 0]
        return pair(goal={"joints": joints, "tip_mm": tip_mm.tolist(), "tolerance_mm": 0.5}, planner={"time_s": 0.1})

    plan = ctrplan.plan(meant(0.3))
    np.testing.assert_allclose(plan.legs[-1].end, there.goal.joints, atol=1e-9)
    assert plan.certificate.valid and plan.certificate.goal_tip_error_m == pytest.approx(0.3e-3, abs=2e-5)
    words = r"goal.joints: leads the frictionless tip to 1.00 mm from goal.tip_mm, beyond tolerance_mm = 0.5"
    with pytest.raises(NoAnswerError, match=words):
        ctrplan.plan(meant(1.0))


def test_figures_of_a_tour_add_up(tour: ctrplan.Plan) -> None:
    certificate, weights = tour.certificate, tour.scenario.cost
    samples = certificate.samples
    assert np.all(np.diff(samples.path_mm) >= 0) and samples.path_mm[-1] == pytest.approx(certificate.length_mm)
    assert np.all(np.diff(samples.leg) >= 0) and samples.leg[-1] == len(tour.legs) - 1
    left = sum(t.bound_m + t.unknown_m for t in certificate.targets) * 1e3
    cost = weights.path * certificate.length_mm + weights.error_along * certificate.released_integral_mm
    cost += weights.stop * (certificate.stops + 1)
    assert certificate.cost_mm == pytest.approx(cost + weights.error_goal * left)
    assert certificate.stops == tour.trajectory.stops
    assert certificate.goal_bound_m == certificate.targets[-1].bound_m


def test_the_benchmark_pays_what_the_planner_pays(tour: ctrplan.Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("benchmarks", "benchmarks/planning"):
        monkeypatch.syspath_prepend(SCENARIOS.parent / folder)
    cost_mm = importlib.import_module("scenarios").cost_mm
    assert cost_mm(tour, tour.scenario.cost) == pytest.approx(tour.certificate.cost_mm)


@pytest.mark.parametrize(("spent_s", "left_s"), [(0.4, 0.2), (0.6, 0.0)])
def test_first_paths_are_charged_to_the_time_of_a_tour(
    spent_s: float, left_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Improving gets what they left; nothing is improved where they left nothing."""
    run_to_first, run, left = StageSearch.run_to_first, StageSearch.run, list[float]()

    def first(search: StageSearch) -> tuple[Candidate, Candidate]:
        found = run_to_first(search)
        search.clock.meter.add(int(spent_s * 1e9))
        return found

    def improved(search: StageSearch) -> tuple[Candidate, Candidate]:
        left.append(search.budget)
        return run(search)

    monkeypatch.setattr(StageSearch, "run_to_first", first)
    monkeypatch.setattr(StageSearch, "run", improved)
    goals = [{"joints": {**START, "rotate inner": turn}} for turn in (10, 20)]
    case = pair(target=goals, planner={"time_s": 1.0})
    plan = ctrplan.plan(case)
    assert plan.certificate.valid and sum(left) <= left_s
    assert plan.ended_by == "count" and len(left) == (2 if left_s else 0)


def test_a_first_path_is_sampled_for_no_longer_than_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the roadmap finds none, with a planner that would go on improving."""
    solve, to_the_first = SearchProblem.solve, list[bool]()

    def noted(problem: SearchProblem, stop: Callable[[float], bool], *, only_first: bool) -> bool:
        to_the_first.append(only_first)
        return solve(problem, stop, only_first=only_first)

    monkeypatch.setattr(SearchProblem, "solve", noted)
    monkeypatch.setattr(StageSearch, "_first_path", lambda search: None)
    checker = MotionChecker(pair(goal={"joints": {**START, "rotate inner": 20}}))
    goals, clock = goal_states(checker, np.random.default_rng(0)), SearchClock(checker.meter, timed=False, budget_s=0.5)
    search = StageSearch(checker, goals, 0, time.monotonic(), 0.5, clock, lambda _: None, threading.Event())
    first, best, _ = search.run_to_first()
    assert first is best and to_the_first and all(to_the_first)


def test_the_drive_rests_at_every_target(tour: ctrplan.Plan) -> None:
    for reached in tour.certificate.targets:
        at = tour.trajectory.leg_end_s[reached.leg]
        k = int(np.argmin(np.abs(tour.trajectory.time_s - at)))
        assert np.linalg.norm(tour.trajectory.position[k] - tour.legs[reached.leg].end) < 1e-3
        assert np.abs(tour.trajectory.velocity[k]).max() < 0.05 * tour.scenario.robot.drive.max_velocity.max()


def test_rests_are_kept_where_legs_go_on_in_one_direction() -> None:
    drive = pair(goal={"joints": START}).robot.drive
    points = np.array([[0, 0, -0.03], [0, 0, -0.01], [0, 0, 0.02]])
    assert time_parameterise(points, drive).stops == 0
    rested = time_parameterise(points, drive, rests=[1])
    assert rested.stops == 1
    halves = [time_parameterise(part, drive).duration_s for part in (points[:2], points[1:])]
    assert rested.duration_s == pytest.approx(sum(halves))
    with pytest.raises(InputError, match="rests"):
        time_parameterise(points, drive, rests=[3])


def line_goal(line_mm: list[list[float]], tolerance_mm: float) -> Goal:
    goal = pair(goal={"line_mm": line_mm, "tolerance_mm": tolerance_mm}).goal
    assert goal.line_m is not None
    return goal


@pytest.mark.parametrize("tolerance_mm", [0.3, 1.0])
def test_tip_stays_by_its_line(tolerance_mm: float) -> None:
    """Made of the tips of a joint path, so that it can be followed; checked with the full model between the corners."""
    scenario = _three_tube()
    checker = MotionChecker(scenario)
    robot = scenario.robot
    path = np.radians([[0, 180, 90, 0], [10, 190, 120, 0], [20, 190, 130, 0]])
    path[:, 3] = [-0.05, -0.045, -0.045]
    tips = [robot.solve(*robot.drive.collars(q)).tip_m for q in path]
    goal = line_goal([(tip * 1e3).tolist() for tip in tips], tolerance_mm)
    corners, failed = follow_line(checker, path[0], goal)
    assert not failed and goal.line_m is not None
    between = np.concatenate(
        [a + np.linspace(0, 1, 6)[:, None] * (b - a) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    )
    followed = np.array([robot.solve(*robot.drive.collars(q)).tip_m for q in between])
    assert distance_from_polyline(followed, goal.line_m).max() <= tolerance_mm * 1e-3
    assert distance_from_polyline(goal.line_m, followed).max() <= tolerance_mm * 1e-3  # all of it


def test_a_line_is_not_left_to_settle() -> None:
    case = pair(goal={"line_mm": [[50, 10, 200], [50, 12, 200]], "tolerance_mm": 0.5})
    checker, corners = MotionChecker(case), np.array([case.start, case.start + [0, 0.2, 0]])
    certificate = certify(case, corners)
    settled = settle(checker, corners, certificate)
    assert settled.certificate is certificate and "off the line" in settled.note
    assert checker.calls == 0  # nothing was tried


def _three_tube() -> Scenario:
    return load_robot_or_scenario(SCENARIOS / "robots" / "three_tube.toml")


def test_a_looser_tolerance_takes_fewer_legs() -> None:
    scenario = _three_tube()
    q = np.append(np.radians([0, 180, 90]), -0.05)
    tip = scenario.robot.solve(*scenario.robot.drive.collars(q)).tip_m * 1e3
    line = [tip.tolist(), (tip + [0, -14, 3]).tolist()]
    counts = []
    for tolerance_mm in (0.05, 2.0):
        corners, failed = follow_line(MotionChecker(scenario), q, line_goal(line, tolerance_mm))
        assert not failed
        counts.append(len(corners))
    assert counts[1] < counts[0]


def test_a_line_out_of_reach_says_where_it_ends() -> None:
    with pytest.raises(NoAnswerError, match="line_mm: can't be followed from none of"):
        ctrplan.plan(pair(goal={"line_mm": [[50, 10, 200], [50, 10, 300]], "tolerance_mm": 0.5}), time_s=1)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "goal: is missing, or"),
        ({"goal": {"tip_mm": [0, 0, 1]}, "target": [{"tip_mm": [0, 0, 1]}]}, "exclude each other"),
        (
            {"target": [{"tip_mm": [0, 0, 1]}, {"tip_mm": [0, 0, 1], "line_mm": [[0, 0, 1], [0, 0, 2]]}]},
            "target.2: must have one",
        ),
        ({"goal": {"line_mm": [[0, 0, 1], [0, 0, 1]]}}, "must have a length"),
        ({"goal": {"line_mm": [[0, 0, 1]]}}, "goal.line_mm"),
    ],
)
def test_contradictory_goals_are_refused(keys: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words.replace(".", r"\.")):
        pair(**keys)


@pytest.mark.parametrize(
    ("second", "words"),
    [
        ({"tip_mm": [300, 0, 0], "tolerance_mm": 1}, "target.2.tip_mm = [300.0, 0.0, 0.0]: out of reach"),
        ({"tip_mm": [300, 0, 0], "tolerance_mm": 1}, "target.2.tolerance_mm = 1"),
        ({"line_mm": [[300, 0, 0], [310, 0, 0]], "tolerance_mm": 1}, "target.2.line_mm.1 = [300.0, 0.0, 0.0]"),
        ({"joints": {**START, "rotate inner": 90}}, "target.2.joints: no goal state keeps the required"),
    ],
)
def test_a_target_that_fails_is_named_as_the_file_names_it(second: dict[str, object], words: str) -> None:
    first = {"joints": {**START, "rotate outer": 10}}
    straight = pair(goal=first)
    least_mm = straight.robot.bound(*straight.robot.drive.collars(straight.start)).position_m * 1e3
    cost = {"max_error_goal_mm": least_mm + 0.05} if "joints" in second else {}
    with pytest.raises(NoAnswerError) as caught:
        ctrplan.plan(pair(target=[first, second], cost=cost), seed=0)
    assert words in str(caught.value) and "goal." not in str(caught.value)


def test_progress_never_runs_backwards() -> None:
    """Over several targets, an oscillation and a compensation: what is nearly done stays nearly done."""
    first = {"tip_mm": [46.7, 6.2, 172.3], "tolerance_mm": 1}
    second = {"tip_mm": [47.0, 10.6, 173.8], "tolerance_mm": 1}
    case = pair(target=[first, second], planner={"time_s": 0.1, "settle": "oscillate"})
    told: list[Progress] = []
    ctrplan.plan(case, seed=0, progress=told.append, compensated=True)
    searched = [progress.fraction for progress in told if progress.stage == "search"]
    assert np.all(np.diff(searched) >= 0) and 0 <= searched[0] < 0.5 and searched[-1] == 1
    for one, then in pairwise(told):
        assert one.stage != then.stage or one.fraction <= then.fraction
    assert {progress.stage for progress in told} == {"search", "certificate"}
