"""Motions: what is refused before it is walked is refused by the walk."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from made_up_input import FUZZ
from places import SCENARIOS

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
