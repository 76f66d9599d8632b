"""Motions: what is refused before it is walked is refused by the walk."""

from __future__ import annotations

import itertools
import pickle

import numpy as np
import pytest
from made_up_input import FUZZ
from places import SCENARIOS

from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import DOUBTFUL_M, MotionChecker
from ctrplan.planning.goal_states import goal_states


@pytest.mark.parametrize("name", ["sinus", "airway"] if FUZZ else ["airway"])
def test_motions_refused_where_they_are_narrowest_are_refused_by_walks(name: str) -> None:
    """And at a fraction of their cost."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    asking, walking = MotionChecker(scenario), MotionChecker(scenario)
    states = [scenario.start, *(goal.joints for goal in goal_states(asking, np.random.default_rng(0))[:12])]
    for q in states:
        asking.state(q)
    verdicts, spent = list[tuple[bool, bool]](), list[tuple[int, int]]()
    for a, b in itertools.permutations(states, 2):
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
    stations = checker._stations(corners)
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
