"""Searches end: in time whatever OMPL does, at Ctrl-C, at once where there is nothing to search for."""

from __future__ import annotations

import itertools
import signal
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from made_up_input import FUZZ, thorough
from places import SCENARIOS

import ctrplan
from ctrplan.base.long_work import CHEAP_QUESTIONS, LEAST_REAL_S, SearchClock, SearchOver, SearchWatch, WorkMeter
from ctrplan.errors import NoAnswerError
from ctrplan.files.scenario_file import load_scenario, scenario_from_dict
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import goal_states, is_at_goal, nearest_turn
from ctrplan.planning.search.ompl_set_up import SearchProblem
from ctrplan.planning.search.stage_search import StageSearch
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Scenario

PLANNERS = ["BIT*", "RRT*", "RRTConnect"]
CASES = settings(
    max_examples=300 if FUZZ else 8, deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
ONE_SOLVE_S = 2.0  # and what else runs on the machine meanwhile: a motion of this pair is solved in a hundredth of that
LATE_QUESTIONS = 2  # the one that is told that the search is over, and the loop around it
SECONDS = st.floats(0.02, 0.3)
# goals close to the start, where BIT* looked at no termination condition for minutes, and anywhere
TURNS = st.one_of(
    st.sampled_from([0.0, 1e-7, 0.1, 0.3, 90.0, 360.0, -360.0, 36000.0]),
    st.floats(-2.0, 2.0),
    st.floats(-40_000.0, 40_000.0),
)
OUTER = st.one_of(st.sampled_from([0.0, 0.1, -0.3]), st.floats(-2.0, 2.0), st.floats(-180.0, 180.0))


def pair(start: tuple[float, float], goal: tuple[float, float], planner: str = "BIT*", **keys: Any) -> Scenario:
    """The pair of Table I between two poses of `rotate outer` and `rotate inner` [deg]."""
    names = ("rotate outer", "rotate inner")
    content = {
        "robot": "robots/table_1_pair.toml",
        "start": dict(zip(names, start, strict=True)),
        "goal": {"joints": dict(zip(names, goal, strict=True))},
        "planner": {"name": planner, "time_s": 0.5},
    }
    return scenario_from_dict(content | keys, file=str(SCENARIOS / "case.toml"))


def stage(scenario: Scenario, time_s: float, *, timed: bool) -> StageSearch:
    """A search for the scenario's only target."""
    checker = MotionChecker(scenario)
    goals, clock = goal_states(checker, np.random.default_rng(0)), SearchClock(checker.meter, timed, time_s)
    return StageSearch(checker, goals, 0, time.monotonic(), time_s, clock, lambda _: None, threading.Event())


@given(
    start=st.tuples(OUTER, st.floats(-180.0, 180.0)),
    by=st.tuples(OUTER, TURNS),
    planner=st.sampled_from(PLANNERS),
    time_s=SECONDS,
    timed=st.booleans(),
    only_first=st.booleans(),
)
@example(start=(0.0, 0.0), by=(0.1, 0.1), planner="BIT*", time_s=0.3, timed=True, only_first=False)
@example(start=(0.0, 0.0), by=(0.3, 0.3), planner="BIT*", time_s=0.3, timed=False, only_first=False)
@example(start=(0.0, 0.0), by=(0.0, 36000.0), planner="BIT*", time_s=0.3, timed=True, only_first=False)
@CASES
def test_no_planner_outlives_its_time(
    start: tuple[float, float], by: tuple[float, float], planner: str, time_s: float, timed: bool, only_first: bool
) -> None:
    """By the clock by a tenth and one solve; counted time, too, as what it counts takes about as long."""
    goal = float(np.clip(start[0] + by[0], -180, 180)), start[1] + by[1]
    checker = MotionChecker(pair(start, goal, planner))
    try:
        goals = goal_states(checker, np.random.default_rng(0))
    except NoAnswerError:
        return  # where the pair would snap
    problem = SearchProblem(checker, goals, seed=0)
    clock, began = SearchClock(checker.meter, timed, time_s), time.monotonic()
    late = list[float]()

    def stop(_: float) -> bool:
        if over := clock.is_past(time_s):
            late.append(clock.now())
        return over

    found = problem.solve(stop, only_first=only_first)
    assert len(late) <= LATE_QUESTIONS
    allowed = 1.1 * time_s if timed else max(10 * time_s, LEAST_REAL_S)
    assert time.monotonic() - began < allowed + ONE_SOLVE_S
    if timed:
        assert clock.now() < allowed + ONE_SOLVE_S
    if found:  # what was found before the end is handed over
        corners = problem.corners()
        np.testing.assert_allclose(checker.space.difference(corners[-1], goals[0].joints), 0, atol=1e-9)
        assert np.isfinite(problem.cost_mm())


@given(goal=st.tuples(OUTER, TURNS), planner=st.sampled_from(PLANNERS), time_s=SECONDS)
@settings(CASES, max_examples=100 if FUZZ else 4)
def test_no_stage_outlives_its_time(goal: tuple[float, float], planner: str, time_s: float) -> None:
    """Roadmap, its growth and sampling together; certificates come on top."""
    try:
        search = stage(pair((0, 0), goal, planner), time_s, timed=True)
    except NoAnswerError:
        return
    on_top = list[float]()

    def timed(method: Any) -> Any:
        def run(*given: Any, **named: Any) -> Any:
            began = time.monotonic()
            result = method(*given, **named)
            on_top.append(time.monotonic() - began)
            return result

        return run

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "_certified", timed(search._certified))
        patch.setattr(search, "_tidied", timed(search._tidied))
        try:
            best = search.run().best
        except NoAnswerError:
            best = None
    assert search.clock.now() - sum(on_top) < 1.1 * time_s + ONE_SOLVE_S
    assert best is None or not best.walk.failure


@pytest.mark.parametrize(("turned_deg", "timed"), [((0.1, 0.1), True), ((0.1, 0.1), False), ((0.3, 0.3), True)])
def test_goals_close_to_the_start_are_reached_in_time(turned_deg: tuple[float, float], timed: bool) -> None:
    began = time.monotonic()
    plan = ctrplan.plan(pair((0, 0), turned_deg), time_s=0.5 if timed else None)
    assert time.monotonic() - began < 10 and plan.certificate.valid
    assert plan.ended_by == ("time" if timed else "count")
    np.testing.assert_allclose(np.degrees(plan.legs[-1].end), turned_deg, atol=1e-9)


@pytest.fixture
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails a test that searches."""
    for method in ("run", "run_to_first"):
        monkeypatch.setattr(StageSearch, method, lambda _: pytest.fail("it searched"))


@pytest.mark.usefixtures("no_search")
@pytest.mark.parametrize("turns", [0, 1, -100])
def test_a_goal_at_the_start_is_no_motion(turns: int) -> None:
    """Whole turns of a rotation without limits are none either; a note says so."""
    plan = ctrplan.plan(pair((20, 30), (20, 30 + 360 * turns)))
    assert plan.certificate.valid and plan.ended_by == "completion"
    assert plan.certificate.length_mm == 0 and plan.trajectory.duration_s == 0
    np.testing.assert_array_equal(plan.legs[0].start, plan.legs[-1].end)
    noted = [note for note in plan.notes if "whole turns" in note]
    assert len(noted) == (1 if turns else 0) and all("rotate inner" in note for note in noted)


@pytest.mark.usefixtures("no_search")
def test_the_start_of_an_insertion_as_its_goal_is_no_motion() -> None:
    scenario = load_scenario(SCENARIOS / "airway.toml")
    goal = replace(scenario.goal, joints=scenario.start, tip_m=None)
    plan = ctrplan.plan(replace(scenario, goal=goal))
    assert plan.certificate.valid and plan.certificate.min_clearance_m > 0 and plan.certificate.length_mm == 0


@pytest.mark.usefixtures("no_search")
def test_a_goal_at_the_start_keeps_the_required_error() -> None:
    with pytest.raises(NoAnswerError, match="no goal state keeps the required worst-case error"):
        ctrplan.plan(pair((0, 90), (0, 90), cost={"max_error_goal_mm": 1e-6}))


def test_a_target_reached_already_is_passed_on_the_way() -> None:
    there = {"rotate outer": 0, "rotate inner": 0}
    further = {"rotate outer": 20, "rotate inner": 20}
    scenario = pair((0, 0), (0, 0))
    content = [replace(scenario.goal, joints=np.radians(list(joints.values()))) for joints in (there, further, there)]
    plan = ctrplan.plan(replace(scenario, via=tuple(content[:-1]), goal=content[-1]))
    assert plan.certificate.valid and len(plan.certificate.targets) == 3
    np.testing.assert_allclose(plan.legs[-1].end, 0, atol=1e-9)


@given(start=st.floats(-400, 400), by=st.floats(-40_000, 40_000))
@settings(max_examples=100)
def test_a_rotation_without_limits_goes_to_the_nearest_turn(start: float, by: float) -> None:
    """At most half a turn from the start and whole turns from the goal."""
    scenario = pair((0, start), (0, start + by))
    goal = nearest_turn(scenario, scenario.start, scenario.goal).joints
    assert goal is not None and scenario.goal.joints is not None
    assert abs(goal[1] - scenario.start[1]) <= np.pi + 1e-9
    turns = (scenario.goal.joints[1] - goal[1]) / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)
    assert is_at_goal(scenario) == bool(abs(goal[1] - scenario.start[1]) <= 1e-9)


def test_a_joint_with_limits_counts_its_turns() -> None:
    """Whoever wants turns gives limits that allow them."""
    limits = {"min_deg": -800, "max_deg": 800}
    overrides = [f"robot.joint.2.{key}={value}" for key, value in limits.items()]
    scenario = load_scenario(SCENARIOS / "pair_free.toml", overrides)
    start = np.zeros_like(scenario.start)
    assert JointSpace.of(scenario).difference(start, start + [0, 2 * np.pi, 0])[1] == 2 * np.pi
    assert not is_at_goal(replace(scenario, start=start, goal=replace(scenario.goal, joints=start + [0, 2 * np.pi, 0])))


@pytest.mark.parametrize("planner", PLANNERS)
def test_ctrl_c_ends_a_search_within_its_loops(planner: str) -> None:
    """Where OMPL asks for nothing but heuristics or motions, and never whether to stop."""
    checker = MotionChecker(pair((0, 0), (0.3, 0.3), planner))
    problem = SearchProblem(checker, goal_states(checker, np.random.default_rng(0)), seed=0)
    pressed = threading.Event()
    previous = signal.signal(signal.SIGALRM, lambda *_: pressed.set())
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    began = time.monotonic()
    try:
        problem.solve(lambda _: pressed.is_set(), only_first=False)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
    assert time.monotonic() - began < 0.3 + ONE_SOLVE_S


@thorough("test_no_planner_outlives_its_time counts some of what takes time")
def test_counted_time_ends_by_the_clock_when_what_it_counts_takes_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where next to nothing is counted of what takes time."""
    checker = MotionChecker(pair((0, 0), (0.3, 0.3)))
    problem = SearchProblem(checker, goal_states(checker, np.random.default_rng(0)), seed=0)
    monkeypatch.setattr("ctrplan.base.long_work.LEAST_REAL_S", 0.2)
    monkeypatch.setattr(WorkMeter, "add", lambda *_: None)
    clock, began = SearchClock(checker.meter, timed=False, budget_s=0.03), time.monotonic()
    problem.solve(lambda _: clock.is_past(0.03), only_first=False)
    assert 0.3 <= time.monotonic() - began < 0.3 + ONE_SOLVE_S
    assert clock.outlasted and clock.ran_out and clock.name == "time"


def test_a_part_of_a_search_that_takes_long_by_the_clock_is_no_end() -> None:
    """A certificate, of which little is counted, may take longer than the part of the search in whose midst it is."""
    clock = SearchClock(WorkMeter(), timed=False, budget_s=20.0)
    clock._really_began_s -= 2 * LEAST_REAL_S
    assert not clock.is_late(0.4) and not clock.is_past(0.4) and not clock.ran_out
    clock._really_began_s -= 10 * 20.0
    assert clock.is_past(0.4) and clock.outlasted


def test_a_watch_ends_what_it_watches_and_nothing_else() -> None:
    watch = SearchWatch()
    watch.ask()
    with watch.until(lambda: False):
        watch.ask()
        with pytest.raises(SearchOver), watch.until(lambda: True):
            for _ in range(CHEAP_QUESTIONS - 1):
                watch.ask_cheaply()
            watch.ask_cheaply()
        watch.ask()
    watch.ask()


def test_every_question_of_the_planner_asks_the_watch() -> None:
    checker = MotionChecker(pair((0, 0), (60, 60)))
    problem = SearchProblem(checker, goal_states(checker, np.random.default_rng(0)), seed=0)
    start, goal = (problem._state(np.radians(turned)) for turned in ([0.0, 0.0], [60.0, 60.0]))
    questions = {
        "isValid": lambda: problem.validity.isValid(start),
        "checkMotion": lambda: problem.motions.checkMotion(start, goal),
        "motionCost": lambda: problem.objective.motionCost(start, goal),
        "motionCostHeuristic": lambda: [problem.objective.motionCostHeuristic(start, goal) for _ in range(100)],
    }
    for name, ask in questions.items():
        with pytest.raises(SearchOver), checker.watch.until(lambda: True):
            ask()
            pytest.fail(f"{name} does not ask")


@pytest.mark.parametrize("questions", [12, 64, 434, 1569])
def test_a_search_that_a_question_ends_has_the_best_path_so_far(questions: int) -> None:
    """It costs what the planner says at most; the planner, left in the midst of its work, is not asked again."""
    checker = MotionChecker(load_scenario(SCENARIOS / "pair_free.toml"))
    problem = SearchProblem(checker, goal_states(checker, np.random.default_rng(0)), 1)
    asked = itertools.count()
    assert problem.solve(lambda _: next(asked) >= questions, only_first=False) and problem.cut_short
    states, cost_mm = problem.states(), problem.cost_mm()
    assert cost_mm <= problem.best_cost() + 1e-9
    np.testing.assert_allclose(checker.space.difference(states[0], checker.scenario.start), 0, atol=1e-12)
    assert problem.objective.is_goal(states[-1])
    assert problem.solve(lambda _: pytest.fail("asked again"), only_first=False)
    assert problem.cost_mm() == cost_mm and len(problem.states()) == len(states)
