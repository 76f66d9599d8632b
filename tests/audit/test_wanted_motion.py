"""What the scenario wants of a motion, looked at by the judge: limits, order, goals, direction."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from stated_plans import in_si, scene_of, stated, table_ii

from ctrplan.audit.verify import broken_promises
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.scenario.scenario import Goal, Scenario

START, MIDDLE, END = [0, 0, 0, -60], [0, 6, 0, -60], [0, 6, 9, -58]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return scene_of(table_ii(), START, END)


def driven(scenario: Scenario, goal: Goal | None = None, end: Any = END, **changes: Any) -> WrittenPlan:
    """A plan through MIDDLE to `end`."""
    wanted = replace(scenario, goal=goal or scenario.goal, **changes)
    return stated(wanted, None, in_si(scenario.robot, [START, MIDDLE, end]))


def tip_at(scenario: Scenario, joints: Any, **changes: Any) -> Goal:
    shape = scenario.robot.solve(*scenario.robot.drive.collars(in_si(scenario.robot, joints)))
    given = {
        "joints": None,
        "tip_m": shape.tip_m,
        "direction": shape.tip_tangent,
        "direction_tolerance_rad": np.radians(5),
    }
    return replace(scenario.goal, **{**given, **changes})


def test_what_arrives_is_kept(scenario: Scenario) -> None:
    assert broken_promises(driven(scenario)) == ()
    assert broken_promises(driven(scenario, tip_at(scenario, END))) == ()
    turned = [0, 6, 9 + 360, -58]
    assert broken_promises(driven(scenario, end=turned)) == ()  # whole turns of an unlimited joint


def test_other_joint_values_are_named(scenario: Scenario) -> None:
    (said,) = broken_promises(driven(scenario, end=[0, 6, 8, -58]))
    assert said == "goal: joint 'rotate inner' ends 1 deg beside the goal's"


def test_a_tip_beside_the_target_or_turned_is_named(scenario: Scenario) -> None:
    goal = tip_at(scenario, END)
    (far,) = broken_promises(driven(scenario, replace(goal, tip_m=goal.tip_m + [0.0, 0.02, 0.0])))
    assert "mm from the target, tolerance 1 mm" in far
    (turned,) = broken_promises(driven(scenario, replace(goal, direction=-goal.direction)))
    assert "off the goal's direction, tolerance 5 deg" in turned


def test_limits_are_looked_at_in_legs_and_trajectory(scenario: Scenario) -> None:
    plan, out = driven(scenario), 61e-3 * (np.arange(4) == 3)
    (legs,) = broken_promises(replace(plan, waypoints=plan.waypoints + out * (np.arange(3) == 1)[:, None]))
    assert legs == "the legs take joint 'translate inner' 1 mm beyond its limit"
    (played,) = broken_promises(
        replace(plan, position=plan.position + out * (np.arange(len(plan.position)) == 9)[:, None])
    )
    assert played.startswith("the trajectory take joint 'translate inner'")


def test_targets_have_an_order(scenario: Scenario) -> None:
    first = tip_at(scenario, MIDDLE, name="first")
    tour = driven(scenario, via=(first,))
    tour.certificate["targets"] = [{"leg": 0}, {"leg": 1}]
    assert broken_promises(tour) == ()
    tour.certificate["targets"] = [{"leg": 1}]
    assert "not those of the scenario" in broken_promises(tour)[-1]
    tour.certificate["targets"] = [{"leg": 1}, {"leg": 1}]
    assert any(sentence.startswith("first: the tip ends") for sentence in broken_promises(tour))


def test_verify_says_them(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    from ctrplan.audit.verify import verify

    monkeypatch.setattr("ctrplan.audit.verify._recomputed", lambda *_: ((), ""))
    result = verify(driven(scenario, end=[0, 6, 8, -58]), work=1)
    assert not result.is_kept and len(result.missed) == 1 and not result.broken
    assert np.isfinite(result.work)
