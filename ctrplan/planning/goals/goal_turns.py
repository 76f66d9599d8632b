"""Whole turns of a joint goal: a rotation without limits ends at the turn nearest to where it begins.

Such a joint stands at the same place after every turn, and turns cost length and friction error. A joint with limits
counts its turns, so that whoever wants them gives it limits that allow them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.joint_space import JointSpace

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Goal, Scenario

AT_GOAL = 1e-9  # rad or m


def nearest_turn(scenario: Scenario, start: Array, goal: Goal) -> Goal:
    """The goal with the unlimited rotations of its joint values at the turn nearest to start (m,); a tip goal as is."""
    if goal.joints is None:
        return goal
    return replace(goal, joints=start + JointSpace.of(scenario).difference(start, goal.joints))


def is_at_goal(scenario: Scenario) -> bool:
    """Whether the start is the scenario's joint goal, to AT_GOAL and whole turns of unlimited rotations."""
    start, goal = scenario.start, scenario.goal.joints
    return goal is not None and bool(np.all(np.abs(JointSpace.of(scenario).difference(start, goal)) <= AT_GOAL))


def turn_notes(scenario: Scenario, ends: Sequence[Array]) -> tuple[str, ...]:
    """A sentence for every unlimited rotation that ends whole turns from the joint goal; ends: (m,) at each target."""
    found = []
    for goal, end in zip(scenario.targets, ends, strict=True):
        if goal.joints is None:
            continue
        drive = scenario.robot.drive
        for joint, wraps, asked, reached in zip(drive.joints, drive.wraps, goal.joints, end, strict=True):
            if wraps and abs(asked - reached) > np.pi:
                asked_deg, reached_deg = np.degrees([asked, reached])
                found.append(
                    f"{joint.name} = {asked_deg:.6g} deg is reached at {reached_deg:.6g} deg, whole turns from it; "
                    "with limits (min_deg, max_deg) the joint would count its turns."
                )
    return tuple(found)
