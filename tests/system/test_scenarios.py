"""The scenario library: every file is listed, reads, starts validly, and some leave a choice that friction decides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

import ctrplan
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import goal_states
from ctrplan.planning.search.proposals import retreat_roadmap
from ctrplan.planning.search.roadmap_search import RoadmapSearch
from ctrplan.scenario.scenario import Goal

FILES = sorted((ROOT / "scenarios").glob("*.toml"))


def test_every_scenario_is_in_the_list() -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    assert len(FILES) >= 8
    for file in FILES:
        assert f"| `{file.stem}` |" in page


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_start_is_valid(file: Path) -> None:
    scenario = load_scenario(file)
    motion = MotionChecker(scenario).state(scenario.start)
    assert motion.valid, motion.reason


@pytest.mark.parametrize("name", ["airway", "ribs", "heart_chamber"])
def test_goals_leave_a_choice_between_bounds(name: str) -> None:
    goals = goal_states(MotionChecker(load_scenario(ROOT / "scenarios" / f"{name}.toml")), np.random.default_rng(0))
    bounds = [goal.bound_m for goal in goals]
    assert len(goals) >= 2 and max(bounds) >= 1.5 * min(bounds)


def test_withdrawing_goes_back_along_the_body() -> None:
    """Chains: tips lie on the goal's own body, ever further back, and every motion of a found path is valid."""
    scenario = load_scenario(ROOT / "scenarios" / "airway.toml")
    checker = MotionChecker(scenario)
    goals = goal_states(checker, np.random.default_rng(0))[:3]
    roadmap = retreat_roadmap(checker, goals)
    assert len(roadmap.goals) == 3 and np.array_equal(roadmap.joints[0], scenario.start)
    first = roadmap.joints[roadmap.goals[0] : roadmap.goals[1]]
    tips, _, _ = checker.mechanics.tips(*scenario.robot.drive.collars(first))
    body = checker.mechanics.zero_clearance(*scenario.robot.drive.collars(first[0])).centreline_m
    off = [np.linalg.norm(body - tip, axis=1).min() for tip in tips]
    assert max(off) < 3.5e-3 and np.all(np.diff(tips[:, 2]) < 0) and tips[-1, 2] < 0.03
    search = RoadmapSearch(checker, roadmap, goals)
    states = search.any_path(lambda: False)
    assert states is not None and np.array_equal(states[0], scenario.start)
    assert any(np.array_equal(states[-1], goal.joints) for goal in goals)
    assert all(checker.motion(a, b).valid for a, b in zip(states[:-1], states[1:], strict=True))
    search.forbid(states, "the test says so")
    other = search.any_path(lambda: False)
    assert other is None or not np.array_equal(other, states)


def test_a_robot_that_cannot_withdraw_has_start_and_goals_alone() -> None:
    scenario = load_scenario(ROOT / "scenarios" / "ribs.toml")
    checker = MotionChecker(scenario)
    goals = goal_states(checker, np.random.default_rng(0))[:2]
    roadmap = retreat_roadmap(checker, goals)
    np.testing.assert_array_equal(roadmap.joints, [scenario.start, *(goal.joints for goal in goals)])
    np.testing.assert_array_equal(roadmap.edges, [[0, 1], [0, 2]])
    np.testing.assert_array_equal(roadmap.goals, [1, 2])


def test_advancing_a_nearly_straight_robot_follows_its_leader() -> None:
    """Tubes 1 and 2 opposed stay near the axis all the way; a rotation at full length inserts nothing."""
    scenario = load_scenario(ROOT / "scenarios" / "deploy.toml")
    free = replace(scenario, anatomy=())
    out = np.array([*scenario.start[:3], -0.09, scenario.start[4]])
    there = replace(free, goal=Goal(out, None, 1e-3))
    off = ctrplan.reorder(np.array([scenario.start, out]), there).follow_the_leader_m
    ends = [scenario.robot.solve(*scenario.robot.drive.collars(q)).centreline_m for q in (scenario.start, out)]
    aside = np.abs(ends[1][:, :2]).max()
    assert off is not None and off <= aside + 1e-3
    turned = out + np.array([0.2, 0.2, 0.2, 0, 0])
    there = replace(free, start=out, goal=Goal(turned, None, 1e-3))
    assert ctrplan.reorder(np.array([out, turned]), there).follow_the_leader_m is None
