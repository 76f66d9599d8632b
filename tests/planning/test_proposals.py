"""What a roadmap is offered: turned insertions are ways as they say, and shapes looked at by halves are all shapes."""

from __future__ import annotations

import itertools
from contextlib import suppress

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import SearchOver
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import descended, goal_states
from ctrplan.planning.search import proposals
from ctrplan.planning.search.proposals import NEAR_MM, TurnedInsertion, direct_roadmap, turned_insertions
from ctrplan.planning.search.roadmap_search import RoadmapSearch

MOST_MM = 280.0


@pytest.fixture(scope="module")
def checker() -> MotionChecker:
    return MotionChecker(load_scenario(SCENARIOS / "deploy.toml"))


@pytest.fixture(scope="module")
def search(checker: MotionChecker) -> RoadmapSearch:
    goals = goal_states(checker, np.random.default_rng(0))
    return RoadmapSearch(checker, direct_roadmap(checker, goals), goals)


def left_mm(search: RoadmapSearch) -> Array:
    weight = search.checker.scenario.cost.error_goal
    return weight * MM_PER_M * np.array([search.left_m[goal] for goal in search.goals.tolist()])


@pytest.fixture(scope="module")
def ways(checker: MotionChecker, search: RoadmapSearch) -> list[TurnedInsertion]:
    goals = search.joints[search.goals]
    return turned_insertions(checker, goals, left_mm(search), np.random.default_rng(1), 1000, MOST_MM)


def test_an_insertion_turns_then_moves_in_then_turns(
    checker: MotionChecker, search: RoadmapSearch, ways: list[TurnedInsertion]
) -> None:
    """Rotations rest while the tubes are inserted, translations are then the goal's, and the way ends at the goal."""
    assert len(ways) > 10
    is_rotation, start = checker.space.drive.is_rotation, checker.scenario.start
    for way in ways:
        goal, (amid, inserted) = search.joints[search.goals[way.goal]], way.states
        np.testing.assert_array_equal(amid[is_rotation], inserted[is_rotation])
        np.testing.assert_array_equal(inserted[~is_rotation], goal[~is_rotation])
        between = (amid - start)[~is_rotation] / (goal - start)[~is_rotation]
        assert ((between >= 0) & (between <= 1)).all()
        stations = way.joints
        np.testing.assert_allclose(stations[0], start)
        assert np.abs(np.diff(stations, axis=0)[:, is_rotation]).max() < np.pi  # nor does the winding leap
        np.testing.assert_allclose(checker.space.difference(stations[-1], goal), 0.0, atol=1e-12)
        turns = np.any(np.diff(stations, axis=0)[:, is_rotation] != 0, axis=1)
        slides = np.any(np.diff(stations, axis=0)[:, ~is_rotation] != 0, axis=1)
        assert not (turns & slides).any()
        assert np.abs(np.diff(slides.astype(int))).sum() == 2  # slides are in the midst of turns, in one piece


def test_insertions_are_free_and_come_cheapest_first(
    checker: MotionChecker, search: RoadmapSearch, ways: list[TurnedInsertion]
) -> None:
    """The shapes of one look at the whole way say so, and the length of its stations."""
    whole = checker.state_rooms(np.concatenate([way.joints for way in ways]))
    np.testing.assert_array_equal(whole, np.concatenate([way.room_m for way in ways]))
    assert whole.min() >= 0
    left = left_mm(search)
    length_mm = [checker.space.lengths_mm(np.diff(way.joints, axis=0)).sum() for way in ways]
    cost = checker.scenario.cost
    least_mm = np.array(
        [cost.path * mm + 4 * cost.stop + left[way.goal] for mm, way in zip(length_mm, ways, strict=True)]
    )
    assert (np.diff(least_mm) > -1e-6).all()
    assert least_mm.max() < MOST_MM


def test_looks_by_halves_lose_no_way_and_keep_none_that_is_not_free(checker: MotionChecker) -> None:
    rng = np.random.default_rng(2)
    ends = checker.space.sample(rng, 60)
    polylines = [checker.stations(np.stack([checker.scenario.start, end])) for end in ends]
    least = [checker.state_rooms(way).min() for way in polylines]
    free = [room_m.min() >= 0 for room_m in proposals._rooms(checker, polylines)]
    np.testing.assert_array_equal(free, np.array(least) >= 0)
    assert any(free)
    assert not all(free)


def test_detours_are_longer_than_the_way_by_what_is_said() -> None:
    """To a place in an ellipsoid and on is uniform by volume: in r dimensions mostly near its surface."""
    rng = np.random.default_rng(3)
    for way in (np.array([50.0, 0.0, 0.0]), np.zeros(3), np.array([3.0, -4.0])):
        given = np.repeat(way[None], 4000, axis=0)
        place = proposals._detours(rng, given)
        longer = np.linalg.norm(place, axis=1) + np.linalg.norm(given - place, axis=1) - np.linalg.norm(way)
        assert longer.min() >= -1e-9
        assert 0.3 * NEAR_MM < longer.mean() < NEAR_MM
        np.testing.assert_allclose(place.mean(axis=0), way / 2, atol=3.0)  # mm: neither end is preferred


def test_insertions_that_grow_are_motions_to_their_goals_and_none_is_known_to_fail(
    checker: MotionChecker, search: RoadmapSearch
) -> None:
    before = len(search.joints)
    search._add_insertions(np.random.default_rng(4), 1200)
    added = np.arange(before, len(search.joints))
    assert len(added) > 0
    assert len(added) % 2 == 0
    for amid, inserted in added.reshape(-1, 2).tolist():
        assert (0, amid) in search.row
        assert (amid, inserted) in search.row
        ends = [b for a, b in search.row if a == inserted]
        assert len(ends) == 1
        assert ends[0] in search.goals
        way = np.concatenate([checker.space.corners(search.joints[0], search.joints[amid], checker.style)])
        stations = checker.stations(np.vstack([way, search.joints[inserted]]))
        solved = [checker._states[q.tobytes()][0] for q in stations if q.tobytes() in checker._states]
        assert all(state.valid for state in solved)


class Places:
    """Ways of places in one dimension: what is expected of them, and what is solved, are given by their rooms."""

    def __init__(self, *rooms_mm: list[float]) -> None:
        self.solved: list[float] = []
        self.ways = [
            TurnedInsertion(np.zeros((2, 1)), k, np.array(mm)[:, None], 1e-3 * np.array(mm))
            for k, mm in enumerate(rooms_mm)
        ]

    def share_valid(self, joints: Array, room_m: Array) -> Array:
        """Falls by half for places within 0.1 mm of one that was refused."""
        refused = [mm for mm in self.solved if mm < 3.0]
        near = [any(abs(mm - 1e3 * room) < 0.1 for mm in refused) for room in room_m]
        return np.clip(1e2 * room_m, 0.0, 1.0) * np.where(near, 0.5, 1.0)

    def is_valid(self, joints: Array, room_m: float) -> bool:
        """Three millimetres are enough."""
        self.solved.append(float(joints[0]))
        return self.solved[-1] >= 3.0

    def likely(self, enough: float | None = None) -> list[int]:
        """The numbers of likely ways."""
        return [way.goal for way in proposals.likely_insertions(self.ways, self.share_valid, self.is_valid, enough)]


def test_ways_are_likely_where_no_place_is_in_doubt_or_those_that_are_were_solved() -> None:
    places = Places([2.0, 9.0], [6.0, 8.0], [4.0, 3.5, 9.0], [0.05, 9.0])
    assert places.likely() == [1, 2]
    assert places.solved == [3.5, 4.0, 2.0]  # the likeliest first, what is hopeless not at all


def test_where_little_doubt_is_enough_nothing_is_solved_once_a_way_is_sure() -> None:
    sure, doubtful = Places([2.0], [6.0], [9.95], [7.0]), Places([2.0, 9.0], [6.0, 7.0], [8.0, 5.5], [3.5])
    assert sure.likely(0.1) == [2, 3, 1]  # with those that are likely
    assert not sure.solved
    assert doubtful.likely(0.1) == [1, 2]
    assert doubtful.solved == [6.0, 7.0]


def test_a_way_that_is_refused_takes_hope_from_ways_like_it() -> None:
    """The way beside is no longer the next to be looked at, and not thrown away either."""
    places = Places([2.95], [2.92], [2.0])
    assert places.likely() == []
    assert places.solved == [2.95, 2.0, 2.92]


def test_none_is_offered_where_a_known_path_costs_less_than_all(checker: MotionChecker, search: RoadmapSearch) -> None:
    goals = search.joints[search.goals]
    assert not turned_insertions(checker, goals, left_mm(search), np.random.default_rng(1), 100, 100.0)


def test_none_is_offered_where_there_is_no_anatomy() -> None:
    """All would be free, and the roadmap full of ways of which nothing is known."""
    free = MotionChecker(load_scenario(SCENARIOS / "snap.toml"))
    goals = np.array([goal.joints for goal in goal_states(free, np.random.default_rng(0))])
    assert not turned_insertions(free, goals, np.zeros(len(goals)), np.random.default_rng(1), 100, np.inf)


def test_a_search_that_ends_in_the_midst_of_growing_has_nothing_half_added(checker: MotionChecker) -> None:
    """Wherever its time is up: what it knows still fits together, and it can grow and be searched again."""
    goals = goal_states(checker, np.random.default_rng(0))[:3]
    search, rng, asked = RoadmapSearch(checker, direct_roadmap(checker, goals), goals), np.random.default_rng(5), 0
    trails = descended(checker, goals)
    for last in range(0, 40, 3):
        count = itertools.count()
        with suppress(SearchOver), checker.watch.until(lambda count=count, last=last: next(count) >= last):
            search.grow(rng, 4, 20)
            search.add_trails(trails)
        asked += next(count) > last
        nodes, edges = len(search.joints), len(search.edges)
        assert len(search.place) == len(search.probed) == nodes
        assert search.goals.max() < nodes and set(search.left_m) == set(search.goals.tolist())
        assert all(len(values) == edges for values in (search.cost, search.left, search.hope, search.known))
        assert search.edges.max() < nodes
    assert asked > 3  # ended in its midst
    search.any_path(lambda: False)
