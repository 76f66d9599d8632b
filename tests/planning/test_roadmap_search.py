"""The roadmap's search against plain relaxation over all its motions, and its hint against the shapes it stands for."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import SearchClock, WorkMeter
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker, Stations
from ctrplan.planning.compensate import aimed
from ctrplan.planning.goal_states import GoalState, descended, goal_state, goal_states
from ctrplan.planning.reordering import as_given
from ctrplan.planning.room import (
    LOSS_M,
    LOSS_MM,
    LOSS_SD_M,
    SCATTER_M,
    ClearanceSurrogate,
    expected_share,
)
from ctrplan.planning.search.ompl_set_up import SearchProblem
from ctrplan.planning.search.polish import Race, Result
from ctrplan.planning.search.proposals import Roadmap, least_cost_mm
from ctrplan.planning.search.roadmap_search import RoadmapSearch
from ctrplan.planning.search.stage_search import StageSearch
from ctrplan.scenario.prediction import TIP_TOLERANCE_M, ball_centre, end_tips, start_states
from ctrplan.scenario.scenario import anatomy_grid
from ctrplan.scenario.tip_solver import target_in_robot_frame


@pytest.fixture(scope="module")
def vessel() -> MotionChecker:
    return MotionChecker(load_scenario(SCENARIOS / "vessel.toml"))


@cache
def vessel_goals(vessel: MotionChecker) -> list[GoalState]:
    """The states found for its target, made once; nobody changes them."""
    return goal_states(vessel, np.random.default_rng(0))


@pytest.fixture(scope="module")
def search(vessel: MotionChecker) -> RoadmapSearch:
    goals = vessel_goals(vessel)[:3]
    joints = np.vstack([vessel.scenario.start, *(goal.joints for goal in goals)])
    found = RoadmapSearch(vessel, Roadmap(joints, np.array([[0, 1], [0, 2], [0, 3]]), np.array([1, 2, 3])), goals)
    found.grow(np.random.default_rng(1), 6)
    return found


def test_the_path_found_is_the_cheapest_of_all(vessel: MotionChecker, search: RoadmapSearch) -> None:
    path = search.cheap_path(lambda: False, doubt=0)
    assert path is not None

    def cost(a: int, b: int, ends_at_goal: bool) -> float:
        motion = vessel.motion(search.joints[a], search.joints[b])
        return vessel.cost_mm(motion, ends_at_goal=ends_at_goal) if motion.valid else np.inf

    prices = {(int(a), int(b)): cost(a, b, False) for a, b in search.edges}
    least = np.where(np.arange(len(search.joints)) == 0, 0.0, np.inf)
    for _ in range(len(least)):
        for (a, b), price in prices.items():
            least[b] = min(least[b], least[a] + price)
    cheapest = min(least[a] + cost(a, b, True) for a, b in prices if b in search.goals)
    nodes = [int(np.argmin(np.abs(search.joints - q).max(axis=1))) for q in path]
    pairs = list(zip(nodes[:-1], nodes[1:], strict=True))
    total = sum(prices[pair] for pair in pairs[:-1]) + cost(*pairs[-1], True)
    assert total == pytest.approx(cheapest, abs=1e-4)
    assert nodes[0] == 0 and nodes[-1] in search.goals
    likely = search.cheap_path(lambda: False, doubt=1)
    assert likely is not None and vessel.state(likely[-1]).valid


def test_a_goal_that_is_passed_is_not_paid_for() -> None:
    target = "goal={tip_mm=[16.1, -30.3, 144.9], tolerance_mm=1.0}"
    dear = MotionChecker(load_scenario(SCENARIOS / "deploy.toml", [target, "cost.error_goal=1000"]))
    trails = descended(dear, goal_states(dear, np.random.default_rng(0))[:1])
    start = dear.scenario.start
    search = RoadmapSearch(dear, Roadmap(start[None], np.empty((0, 2), dtype=int), np.empty(0, dtype=int)), [])
    search.add_trails(trails)
    first, last = 1, len(trails[0])
    np.testing.assert_array_equal(search.joints[[first, last]], [trails[0][0].joints, trails[0][-1].joints])
    search.cost[:] = np.where(search.edges[:, 0] == 0, np.inf, search.cost)  # no other way down than along the trail
    search.extend(np.empty((0, len(start))), np.array([[0, first]]))
    search.cost[-1], search.known[-1] = 1.0, True
    path = search.cheap_path(lambda: False, doubt=0)
    assert path is not None and len(path) > 2
    np.testing.assert_array_equal(path[1], search.joints[first])
    assert search.left_m[int(np.argmin(np.abs(search.joints - path[-1]).max(axis=1)))] < search.left_m[first]


def test_a_forbidden_path_is_not_found_again(vessel: MotionChecker, search: RoadmapSearch) -> None:
    path = search.any_path(lambda: False)
    assert path is not None
    assert all(vessel.motion(a, b).valid for a, b in zip(path[:-1], path[1:], strict=True))
    search.forbid(path, "refused")
    other = search.any_path(lambda: False)
    assert other is None or not np.array_equal(other, path)


def test_a_motion_of_the_next_path_is_checked_ahead(vessel: MotionChecker, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a path of one motion, while any path will do; of the cheapest path nothing else is checked."""
    goals = vessel_goals(vessel)[:3]
    joints = np.vstack([vessel.scenario.start, *(goal.joints for goal in goals)])
    roadmap = Roadmap(joints, np.array([[0, 1], [0, 2], [0, 3]]), np.array([1, 2, 3]))
    together, checked, ahead = threading.Barrier(2), list[int](), list[int]()

    def check(search: RoadmapSearch, k: int) -> None:
        if k not in ahead[:-1]:
            together.wait(10.0)  # breaks where neither of both is checked beside the other
        search.known[k], search.cost[k] = True, 1.0 if checked else np.inf
        checked.append(k)

    def look_ahead(_: MotionChecker, start: Array, goal: Array) -> None:
        together.wait(10.0)
        ahead.append(int(np.flatnonzero((joints[1:] == goal).all(axis=1))[0]))

    monkeypatch.setattr(
        MotionChecker, "look", lambda _, ways: [Stations(way, np.ones(len(way)), jumps=False) for way in ways]
    )
    monkeypatch.setattr(RoadmapSearch, "_check", check)
    monkeypatch.setattr(MotionChecker, "look_ahead", look_ahead)
    search = RoadmapSearch(vessel, roadmap, goals)
    assert search.any_path(lambda: False) is not None
    assert len(checked) == 2 and ahead[0] == checked[1]
    search, checked[:], ahead[:] = RoadmapSearch(vessel, roadmap, goals), [], []
    monkeypatch.setattr(RoadmapSearch, "_check", lambda s, k: (checked.append(k), s.known.__setitem__(k, True)))
    assert search.cheap_path(lambda: False, doubt=0) is not None and (len(checked), ahead) == (1, [])


def test_what_is_checked_ahead_counts_when_it_is_asked_for(vessel: MotionChecker) -> None:
    """The result and the counted work equal those of a check that is made when it is needed."""
    plain, early = MotionChecker(vessel.scenario), MotionChecker(vessel.scenario)
    goal, start = vessel_goals(vessel)[0], vessel.scenario.start
    early.look_ahead(start, goal.joints)
    assert early.meter.spent_ns == 0
    assert early.motion(start, goal.joints) == plain.motion(start, goal.joints)
    assert early.meter.spent_ns == plain.meter.spent_ns > 0
    calls = early.calls
    early.look_ahead(start, goal.joints)
    early.motion(start, goal.joints)
    assert early.calls == calls


def test_a_path_through_one_of_two_equal_states_can_be_forbidden(vessel: MotionChecker) -> None:
    """By the same motions through the other one it is not found again."""
    goal = vessel_goals(vessel)[0]
    start = vessel.scenario.start
    beside = start + np.where(vessel.space.drive.is_rotation, 0.05, 0.0)
    roadmap = Roadmap(np.array([start, beside, beside, goal.joints]), np.array([[1, 3], [0, 2], [2, 3]]), np.array([3]))
    search = RoadmapSearch(vessel, roadmap, [goal])
    search.cost[:], search.known[:] = 1.0, True
    path = search.known_path()
    assert path is not None and len(path.states) == 3 and path.cost_mm == pytest.approx(2.0 + search.left[-1])
    search.forbid(path.states, "refused")
    search.extend(np.empty((0, len(start))), np.array([[0, 1]]))
    search.known[-1] = True
    assert search.known_path() is None and not vessel.motion(beside, goal.joints).valid


@pytest.mark.parametrize(("broken_share", "refused"), [([], [0, 1]), ([0.2], [0]), ([0.9], [1]), ([0.5], [0, 1])])
def test_only_motions_on_which_a_limit_is_broken_are_forbidden(
    vessel: MotionChecker, broken_share: list[float], refused: list[int]
) -> None:
    """Both that meet where it is broken; all of them where it is not known which is to blame."""
    checker = MotionChecker(vessel.scenario)
    goal, start = goal_states(checker, np.random.default_rng(0))[0], checker.scenario.start
    middle = start + checker.space.difference(start, goal.joints) / 2
    roadmap = Roadmap(np.array([start, middle, goal.joints]), np.array([[0, 1], [1, 2]]), np.array([2]))
    search = RoadmapSearch(checker, roadmap, [goal])
    search.cost[:], search.known[:] = 1.0, True
    known = search.known_path()
    assert known is not None
    path = known.states
    whole = float(checker.space.lengths_mm(checker.space.difference(path[:-1], path[1:])).sum())
    search.forbid_at(path, whole * np.array(broken_share), "refused")
    assert np.flatnonzero(~np.isfinite(search.cost)).tolist() == refused
    forbidden = [checker.motion(a, b).reason == "refused" for a, b in zip(path[:-1], path[1:], strict=True)]
    assert np.flatnonzero(forbidden).tolist() == refused


def test_a_path_leaves_the_room_that_certificates_turned_out_to_need(vessel: MotionChecker) -> None:
    goals = vessel_goals(vessel)[:2]
    joints = np.vstack([vessel.scenario.start, *(goal.joints for goal in goals)])
    search = RoadmapSearch(vessel, Roadmap(joints, np.array([[0, 1], [0, 2]]), np.array([1, 2])), goals)
    search.known[:], search.cost[:], search.left[:], search.solved_m[:] = True, [1.0, 2.0], 0.0, [0.2e-3, 0.9e-3]
    paths = []
    for needed_m in (0.0, 0.5e-3, 1e-3):
        search.needed_m = needed_m
        paths.append(search.known_path())
    assert [path and path.cost_mm for path in paths] == [1.0, 2.0, None]


def test_goals_are_promising_by_what_cannot_be_shortened(vessel: MotionChecker) -> None:
    """With known paths to two, the one with less left comes first, though its way is dearer by nearly as much."""
    goals = vessel_goals(vessel)[:3]
    joints = np.vstack([vessel.scenario.start, *(goal.joints for goal in goals)])
    search = RoadmapSearch(vessel, Roadmap(joints, np.array([[0, 1], [0, 2], [0, 3]]), np.array([1, 2, 3])), goals)
    weights = vessel.scenario.cost
    straight_mm = least_cost_mm(vessel, vessel.space.difference(joints[0], joints[1:]))
    search.left_m = {k: (100.0 - straight_mm[k - 1]) / weights.error_goal / MM_PER_M for k in (1, 2, 3)}
    search.left_m[2] -= 50.0 / weights.error_goal / MM_PER_M
    search.known[:], search.left[:], search.cost[:] = [True, True, False], 0.0, [100.0, 149.0, 0.0]
    assert (order := list(search.promising_goals()))[0] == 2 and sorted(order) == [1, 2, 3]
    for k in (1, 2):
        known = search.known_path(k)
        assert known is not None and np.array_equal(known.states[-1], joints[k])
    assert search.known_path(3) is None
    cheapest = search.known_path()
    assert cheapest is not None and np.array_equal(cheapest.states[-1], joints[1])


def test_no_random_state_is_drawn_twice() -> None:
    """Where the search for a first path grew the roadmap, and that for the cheapest does so again."""
    checker = MotionChecker(load_scenario(SCENARIOS / "pair_free.toml"))
    goals, clock = goal_states(checker, np.random.default_rng(0)), SearchClock(checker.meter, timed=False, budget_s=3.0)
    search = StageSearch(checker, goals, 0, time.monotonic(), 3.0, clock, lambda _: None, threading.Event())
    drawn: list[Array] = []

    def grow(_: RoadmapSearch, rng: np.random.Generator, count: int, _insertions: int) -> None:
        drawn.append(rng.random(5))
        clock.meter.add(count * 10**6)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RoadmapSearch, "grow", grow)
        patch.setattr(RoadmapSearch, "any_path", lambda search, *_: search.joints if len(drawn) > 2 else None)
        search._cheapest_of(search._first_path())
    assert len(drawn) > 3 and len(np.unique(np.concatenate(drawn))) == sum(map(len, drawn))


def test_rooms_of_zero_clearance_shapes_are_those_of_their_centrelines(vessel: MotionChecker) -> None:
    scenario, grid = vessel.scenario, anatomy_grid(vessel.scenario)
    assert grid is not None and vessel.field is not None
    joints = vessel.space.sample(np.random.default_rng(3), 12)
    theta_b, l_b = vessel.space.drive.collars(joints)
    found, _ = vessel.mechanics.zero_clearance_rooms(theta_b, l_b, vessel.field, spacing_m=1e-3)
    for k in np.flatnonzero(np.isfinite(found)):
        shape = vessel.mechanics.zero_clearance(theta_b[k], l_b[k])
        ahead = shape.s_m >= 0
        points = shape.centreline_m[ahead] @ scenario.base_R.T + scenario.base_position_m
        expected = float((grid.sample(points) - shape.radius_m[ahead]).min())
        assert found[k] == pytest.approx(expected, abs=1e-3)  # other points of the same line, at most 1 mm apart
    coarse, tips = vessel.mechanics.zero_clearance_rooms(theta_b, l_b, vessel.field, spacing_m=4e-3)
    np.testing.assert_allclose(coarse, found, atol=4e-3)
    np.testing.assert_allclose(tips, vessel.mechanics.tips(theta_b, l_b)[0], atol=1e-6)  # of other steps along the line


def test_every_leg_is_charged_for_its_stop(vessel: MotionChecker) -> None:
    dear = MotionChecker(load_scenario(SCENARIOS / "vessel.toml", ["cost.stop=7"]))
    start = vessel.scenario.start
    turned = start + np.where(vessel.space.drive.is_rotation, 0.1, 0.0)
    moved = turned + np.where(vessel.space.drive.is_rotation, 0.0, 1e-3)
    for end, legs in ((start, 0), (turned, 1), (moved, 2)):
        motion = vessel.motion(start, end)
        extra = dear.cost_mm(motion, ends_at_goal=False) - vessel.cost_mm(motion, ends_at_goal=False)
        assert extra == pytest.approx((7 - vessel.scenario.cost.stop) * legs)
        assert motion.legs == legs


def test_counted_time_is_work_alone() -> None:
    meter = WorkMeter()
    meter.add(10**9)
    clock = SearchClock(meter, timed=False, budget_s=3.0)
    assert clock.now() == 0 and not clock.is_past(1.5)
    meter.add(2 * 10**9)
    assert clock.now() == pytest.approx(2.0) and clock.is_past(1.5) and clock.ran_out and clock.name == "count"


def test_a_search_without_a_valid_goal_ends_at_once(vessel: MotionChecker) -> None:
    goal = vessel_goals(vessel)[0]
    inside_the_wall = replace(goal, joints=goal.joints + [3.0, 3.0, 0, 0])
    assert not vessel.state(inside_the_wall.joints).valid
    problem = SearchProblem(vessel, [inside_the_wall], seed=0)
    assert not problem.solve(lambda cost: pytest.fail("it waits for another goal"), only_first=True)


def test_motions_that_snap_are_suspected_beforehand_and_others_are_not() -> None:
    checker = MotionChecker(load_scenario(SCENARIOS / "snap.toml"))
    joints, found = checker.space.sample(np.random.default_rng(0), 40), list[tuple[bool, bool]]()
    start, goal = checker.scenario.start, goal_states(checker, np.random.default_rng(0))[0].joints
    for a, b in [(start, goal), (goal, start), *zip(joints[:-1], joints[1:], strict=True)]:
        if checker.state(a).valid and checker.state(b).valid:
            way = checker.space.corners(a, b, checker.style)
            found.append((checker.look([way])[0].jumps, checker.motion(a, b).valid))
    assert found[:2] == [(True, False), (True, False)]  # what the scenario was made for
    assert np.mean([suspected != valid for suspected, valid in found]) > 0.95
    assert sum(valid for _, valid in found) > 20


def test_a_surrogate_expects_what_regression_on_all_solved_states_does(vessel: MotionChecker) -> None:
    space, rng = vessel.space, np.random.default_rng(5)
    joints, room_m = space.sample(rng, 40), rng.uniform(0, 6e-3, 40)
    clearance_m = room_m - rng.normal(LOSS_M, LOSS_SD_M, 40)
    surrogate, order = ClearanceSurrogate(space), rng.permutation(25)
    places = surrogate.extend(joints[:30], room_m[:30])
    for place in order:
        surrogate.learn(int(places[place]), float(clearance_m[place]))
    surrogate.extend(joints[30:], room_m[30:])  # after it has learned
    turns = space.drive.is_rotation
    at = np.concatenate([np.exp(1j * joints[:, turns]), joints[:, ~turns] * MM_PER_M / space.weights_mm[0]], axis=1)
    apart = np.linalg.norm(at[:, None] - at, axis=2) * space.weights_mm[0] * np.sqrt(3) / LOSS_MM
    prior = LOSS_SD_M**2 * (1 + apart) * np.exp(-apart)
    gain = prior[:, :25] @ np.linalg.inv(prior[:25, :25] + SCATTER_M**2 * np.eye(25))
    np.testing.assert_allclose(surrogate.loss_m, LOSS_M + gain @ ((room_m - clearance_m)[:25] - LOSS_M), atol=1e-9)
    np.testing.assert_allclose(surrogate.variance, LOSS_SD_M**2 - (gain * prior[:, :25]).sum(axis=1), atol=1e-12)
    beside = surrogate.share_valid_at(joints[30:] + 2 * np.pi * turns, room_m[30:])
    np.testing.assert_allclose(beside, surrogate.share_valid()[30:], atol=1e-9)  # and it is the same after a turn


def test_many_solved_states_in_one_place_leave_a_surrogate_sound(vessel: MotionChecker) -> None:
    surrogate, q = ClearanceSurrogate(vessel.space), np.tile(vessel.scenario.start, (60, 1))
    q[:, 0] += np.linspace(0, 1e-9, 60)
    for place in surrogate.extend(q, np.full(60, 2e-3)):
        surrogate.learn(int(place), 0.5e-3)
    np.testing.assert_allclose(surrogate.loss_m, 1.5e-3, atol=1e-5)
    assert np.all(surrogate.variance > -1e-12) and np.all(surrogate.variance < SCATTER_M**2)


def test_what_a_search_has_solved_tells_which_states_are_valid() -> None:
    checker = MotionChecker(load_scenario(SCENARIOS / "sinus.toml"))
    q = checker.space.sample(np.random.default_rng(2), 900)
    room_m = checker.rooms([row[None] for row in q])
    near = np.flatnonzero((room_m > -1e-3) & (room_m < 5e-3))[:60]
    q, room_m = q[near], room_m[near]
    valid = np.array([checker.state(row).valid for row in q])
    beside = checker.space.wound_into_limits(q + 0.01 * np.random.default_rng(3).normal(size=q.shape) * [1, 1, 1, 0, 0])
    surrogate = ClearanceSurrogate(checker.space)
    for place, row in zip(surrogate.extend(q, room_m), q, strict=True):
        surrogate.learn(int(place), checker.solved_room_m(row))
    rooms = checker.rooms([row[None] for row in beside])
    is_expected = surrogate.share_valid_at(beside, rooms) > 1 / 2
    is_guessed = expected_share(rooms) > 1 / 2
    truly = np.array([checker.state(row).valid for row in beside])
    assert 10 < valid.sum() < 50
    assert np.mean(is_expected == truly) > 0.95 > np.mean(is_guessed == truly)


def stage_search(vessel: MotionChecker) -> StageSearch:
    """A search of two counted seconds."""
    goals = vessel_goals(vessel)
    clock = SearchClock(vessel.meter, timed=False, budget_s=2.0)
    return StageSearch(vessel, goals, 0, time.monotonic(), 2.0, clock, lambda _: None, threading.Event())


def race_begun(search: StageSearch) -> tuple[Race, Array]:
    """A race on the roadmap that has a first path, and this path (K, m)."""
    race = Race(search._first_path(), search._expanded, 0, is_compensated=True, moves_goal=True)
    assert search.best is not None
    return race, search.best.corners


def test_only_what_can_be_compensated_is_polished(vessel: MotionChecker, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cheap path that misses its target is none."""
    search = stage_search(vessel)
    roadmap = search._first_path()
    for can_be_moved in (True, False):
        if not can_be_moved:
            monkeypatch.setattr("ctrplan.planning.search.polish.aimed", lambda checker, corners: (checker, corners))
        race = Race(roadmap, search._expanded, 0, is_compensated=True, moves_goal=True)
        race.run(search.clock.now, search.clock.now() + 0.2, search._is_over)
        assert bool(race.racers) == can_be_moved
        assert all(racer.is_aimed for racer in race.racers)


def test_a_path_whose_aimed_beginning_has_no_room_is_polished_from_where_it_is(
    vessel: MotionChecker, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = stage_search(vessel)
    race, path = race_begun(search)
    monkeypatch.setattr("ctrplan.planning.search.polish.aimed", lambda checker, q: (checker.without_reserve(), q + 1.0))
    racer = race._begun(path)
    assert racer is not None and racer is race.racers[0]
    np.testing.assert_array_equal(racer.trail[0][1], path)


def test_results_are_the_cheapest_as_driven(vessel: MotionChecker) -> None:
    """All paths that polish came by are offered by that, whatever they promised; but those that can't be driven."""
    search = stage_search(vessel)
    (race, _), rng = race_begun(search), search._rng
    for _ in range(20):
        dearer_mm = rng.exponential(2.0, size=9) * rng.integers(0, 2, size=9)
        promised = np.sort(rng.uniform(100.0, 110.0, size=9))[::-1]
        is_driven = rng.uniform(size=9) < 0.7
        paths = [(float(cost), np.array([k])) for k, cost in enumerate(promised)]
        race.racers = [SimpleNamespace(trail=paths[:4]), SimpleNamespace(trail=paths[4:])]  # type: ignore[list-item]

        def result(_: MotionChecker, corners: Array, of: tuple[Array, ...] = (promised + dearer_mm, is_driven)) -> Any:
            k = int(corners[0])
            return Result(corners, corners, float(of[0][k])) if of[1][k] else None

        race._result = result  # type: ignore[method-assign]
        expected = np.sort((promised + dearer_mm)[is_driven])
        assert [driven.cost_mm for driven in race.results()] == pytest.approx(expected.tolist())


def test_a_race_s_results_end_at_the_goal_and_cost_what_they_do_as_driven(vessel: MotionChecker) -> None:
    """Where compensation leads from there, by the race's own word and anew."""
    search = stage_search(vessel)
    race, path = race_begun(search)
    race.run(search.clock.now, search.clock.now() + 0.3, search._is_over)
    results = list(race.results())
    assert results
    for result in results:
        there, _ = aimed(vessel.without_reserve(), result.to_goal)
        off = (
            there.scenario.goal.tip_m
            - there.mechanics.tips_with_friction(  # type: ignore[operator]
                *vessel.space.drive.collars(result.driven[-1:]), np.zeros((1, vessel.mechanics.n - 1))
            ).position_m
        )
        assert np.linalg.norm(off) < 2 * TIP_TOLERANCE_M  # both are aimed where friction leaves what was aimed for
        motion = there.along(result.driven)
        assert goal_state(vessel.without_reserve(), result.to_goal[-1]).tip_error_m < 0.1e-3
        assert motion.valid and there.cost_mm(motion, ends_at_goal=True) == pytest.approx(result.cost_mm)
    assert results[0].cost_mm < race.cost_mm(path, np.inf)


def test_a_path_that_cannot_be_moved_costs_what_it_misses_and_another_order_is_priced_as_driven(
    vessel: MotionChecker, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = stage_search(vessel)
    (race, path), scenario = race_begun(search), vessel.scenario
    monkeypatch.setattr("ctrplan.planning.search.polish.aimed", lambda checker, corners: (checker, corners))
    middle = ball_centre(end_tips(scenario.robot, path, start_states(scenario)))
    miss_mm = 1e3 * np.linalg.norm(target_in_robot_frame(scenario) - middle)
    assert miss_mm > 0.01
    assert race.cost_mm(path, 100.0) == pytest.approx(100.0 + scenario.cost.error_goal * miss_mm)
    other = as_given(vessel, np.vstack([path[:1], path[1] + 0.1 * (path[0] - path[1]), path[1:]]))
    monkeypatch.setattr("ctrplan.planning.search.polish.least_error_order", lambda *_: other)
    for driven_mm, taken in ((99.0, other.after), (101.0, path)):
        monkeypatch.setattr(Race, "cost_mm", lambda *_, driven_mm=driven_mm: driven_mm)
        assert np.array_equal(race.ordered(Result(path, path, 100.0), vessel, path).after, taken)
