"""Motions: what is refused before it is walked is refused by the walk."""

from __future__ import annotations

import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from made_up_input import FUZZ
from places import SCENARIOS

from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.walk import KnownLegs, PathLimits, PathSamples
from ctrplan.motion.checker import DOUBTFUL_M, MotionChecker
from ctrplan.planning.goal_states import goal_states


@pytest.mark.parametrize("name", ["sinus", "airway"] if FUZZ else ["airway"])
def test_motions_refused_where_they_are_narrowest_are_refused_by_walks(name: str) -> None:
    """A look at the narrowest place refuses what a walk refuses, at a fraction of the work."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    asking, walking = MotionChecker(scenario), MotionChecker(scenario)
    states = [scenario.start, *(goal.joints for goal in goal_states(asking, np.random.default_rng(0))[:12])]
    for q in states:
        asking.state(q)
    verdicts, spent = list[tuple[bool, bool]](), list[tuple[int, int]]()
    for a, b in itertools.permutations(states, 2) if FUZZ else itertools.combinations(states, 2):
        corners = asking.space.corners(a, b, asking.style)
        if not 0 < asking.rooms([corners])[0] < DOUBTFUL_M:
            continue
        before = asking.meter.spent_ns, walking.meter.spent_ns
        verdicts.append((asking.motion(a, b).valid, walking.along(corners).valid))
        if not verdicts[-1][0]:
            spent.append((asking.meter.spent_ns - before[0], walking.meter.spent_ns - before[1]))
    assert {valid for valid, _ in verdicts} == {True, False}
    assert np.mean([asked == walked for asked, walked in verdicts]) > 0.97  # a walk may step over a narrow place
    assert not any(asked and not walked for asked, walked in verdicts)
    assert np.sum(spent, axis=0)[0] < 0.8 * np.sum(spent, axis=0)[1]


def test_stations_hold_the_corners_themselves() -> None:
    """States at corners are known already: their bytes are what they are remembered by."""
    checker = MotionChecker(load_scenario(SCENARIOS / "vessel.toml"))
    rng = np.random.default_rng(0)
    corners = checker.space.sample(rng, 6)
    stations = checker.stations(corners)
    for q in corners:
        assert any(q.tobytes() == station.tobytes() for station in stations)


def test_batches_are_the_rows_one_by_one_on_any_number_of_threads() -> None:
    """What is no state is a row that is not valid, and fails no other one."""
    scenario = load_scenario(SCENARIOS / "pair_free.toml")
    alone, drive = MotionChecker(scenario), scenario.robot.drive
    a, b = scenario.start + np.random.default_rng(1).uniform(-0.4, 0.4, (2, 40, len(drive.joints))) * drive.is_rotation
    a[7] = np.nan
    b[9, ~drive.is_rotation] = 0.3
    motions = [alone.motion(*row) if np.isfinite(row).all() else None for row in zip(a, b, strict=True)]
    for threads in (1, 4):
        checker = MotionChecker(scenario)
        found = checker.motions(a, b, threads=threads)
        assert [motion for motion in found if motion.reason != "joint values must be finite"] == [
            motion for motion in motions if motion is not None
        ]
        assert not found[7].valid and not found[9].valid and sum(motion.valid for motion in found) > 20
        states = checker.check(b, threads=threads)
        assert list(states) == [alone.state(q) for q in b] and states[8].valid
    assert checker.motions(a[:0], b[:0]) == ()
    with pytest.raises(InputError, match="must have shape"):
        checker.motions(a, b[:3])


def test_a_checker_is_pickled_as_what_it_was_made_of() -> None:
    checker = MotionChecker(load_scenario(SCENARIOS / "vessel.toml"), "simultaneous", reserve_m=1e-4)
    again = pickle.loads(pickle.dumps(checker))
    assert (again.style, again.reserve_m, again.limits) == (checker.style, checker.reserve_m, checker.limits)
    assert again.state(checker.scenario.start) == checker.state(checker.scenario.start)


def test_walks_that_remember_legs_are_walks_of_the_whole() -> None:
    """Also where a leg breaks a limit; and a path that was walked costs nothing again."""
    scenario = load_scenario(SCENARIOS / "vessel.toml")
    whole, by_legs = MotionChecker(scenario), MotionChecker(scenario)
    goals = goal_states(whole, np.random.default_rng(0))
    ways = [whole.space.corners(scenario.start, goal.joints, whole.style) for goal in goals]
    ends = next(way for way in ways if whole.along(way).valid)
    rng, verdicts = np.random.default_rng(1), list[bool]()
    for size in (0.0, 0.01, 0.02, 0.05, 0.5, 1.0):
        inner = ends[:-1] + rng.normal(size=(len(ends) - 1, ends.shape[1])) * size * (ends[-1] - ends[0])
        path = np.concatenate([ends[:1], inner[1:], ends[-1:], inner[1:]])
        expected, walked = whole.along(path), by_legs.along(path, remembers=True)
        verdicts.append(expected.valid)
        assert walked.valid == expected.valid and walked.reason == expected.reason
        if expected.valid:
            figures = [(x.length_mm, x.error_integral_mm, x.end_bound_m, x.end_error_m) for x in (walked, expected)]
            np.testing.assert_allclose(*figures, rtol=1e-6, atol=1e-9)
            before = by_legs.meter.spent_ns
            by_legs.along(path, remembers=True)
            assert by_legs.meter.spent_ns == before
    assert {True, False} == set(verdicts)


def test_a_leg_that_begins_at_another_equilibrium_is_walked_with_the_one_before() -> None:
    """A walk that leads into another shape than the one solved afresh at its end is no walk of its legs."""
    samples = MotionChecker(load_scenario(SCENARIOS / "airway.toml"))
    corners = samples.scenario.start + np.linspace(0, 0.05, 4)[:, None] * samples.space.drive.is_rotation
    calls = list[int]()

    def walk(rows: np.ndarray) -> PathSamples:
        """Shapes of a walk that begins at any corner but the first are 1 mm off."""
        calls.append(len(rows))
        result = samples.walk(rows, samples.density, PathLimits())
        return result if np.array_equal(rows[0], corners[0]) else replace(result, tip_m=result.tip_m + 1e-3)

    legs = KnownLegs(walk, lambda _: False)
    legs.along(corners[:2])
    np.testing.assert_array_equal(legs.along(corners).tip_m, walk(corners).tip_m)
    assert calls == [2, 3, 4, 4]
