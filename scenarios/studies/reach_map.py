"""How near the tip comes to a point, with regard to friction and without it: the function of the reach maps.

Without regard to friction a point is reached where some configuration brings the frictionless tip there and keeps all
limits and margins in its frictionless shape. With regard to it the shapes of all corners have to keep them, and what
counts is how far from the point friction may leave the tip at worst.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import ctrplan
from ctrplan.anatomy.clearance_grid import content_key
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.limits import path_limits
from ctrplan.planning.goal_states import descended
from ctrplan.planning.reach import Configuration
from ctrplan.scenario.scenario import Goal
from ctrplan.scenario.tip_solver import GoalState

NEAR_MM = (1.0, 2.0)
STARTS = 40  # of inverse kinematics; more find a little more
LED_DOWN = 2  # configurations of each target whose bound is led down
PLACES = 2  # kept, of tasks that follow each other


def reach(scenario: ctrplan.Scenario, inputs: Mapping[str, Any], seed: int, starts: int = STARTS) -> dict[str, Any]:
    """Numbers of the scenario's target; its tolerance is how near the frictionless tip has to come."""
    place, goal = place_of(scenario), scenario.goal
    found = ctrplan.inverse_kinematics(
        place.frictionless, goal.tip_m, tolerance_m=goal.tolerance_m, starts=starts, seed=seed
    )
    free_mm = min((way.tip_error_m for way in found.valid), default=math.inf) * 1e3
    best = place.least(goal, found.valid)
    worst_mm = math.inf if best is None else miss_m(best) * 1e3
    return {
        "configurations": len(found.configurations),
        "valid": len(found.valid),
        "free_mm": known(free_mm),
        "worst_mm": known(worst_mm),
        "bound_mm": None if best is None else best.bound_m * 1e3,
        "within_tolerance": worst_mm <= goal.tolerance_m * 1e3,
        **{f"free_within_{near:g}_mm": free_mm <= near for near in NEAR_MM},
        **{f"within_{near:g}_mm": worst_mm <= near for near in NEAR_MM},
    }


@dataclass(frozen=True, eq=False)
class Place:
    """A robot in an anatomy, with all that is computed once for many targets."""

    scenario: ctrplan.Scenario

    @cached_property
    def frictionless(self) -> ctrplan.Scenario:
        """The same without friction."""
        robot = self.scenario.robot
        content = copy.deepcopy(dict(robot.content))
        for contact in content["contact"]:
            contact["friction_coefficient"] = 0.0
        return replace(self.scenario, robot=robot_from_dict(content, file=robot.path))

    @cached_property
    def checker(self) -> MotionChecker:
        """What says whether a configuration keeps all limits and margins in every corner."""
        return self._checker(self.scenario)

    def least(self, goal: Goal, ways: Sequence[Configuration]) -> GoalState | None:
        """The configuration whose tip friction leaves nearest to the goal at worst, valid in every corner.

        Of the best ones the bound is led down among configurations that reach the goal as well.
        """
        probed = [GoalState(way.joints, self.checker.probe(way.joints)[0].end_bound_m, way.tip_error_m) for way in ways]
        known = sorted((state for state in probed if math.isfinite(state.bound_m)), key=miss_m)
        if not known:
            return None
        trails = descended(self._checker(replace(self.scenario, goal=goal, via=())), known[:LED_DOWN])
        return min([known[0], *(state for trail in trails for state in trail)], key=miss_m)

    @staticmethod
    def _checker(scenario: ctrplan.Scenario) -> MotionChecker:
        checker = MotionChecker(scenario)
        checker.limits = path_limits(scenario)
        return checker


def miss_m(state: GoalState) -> float:
    """[m] of the tip from the target at worst."""
    return state.tip_error_m + state.bound_m


PLACED: dict[str, Place] = {}


def place_of(scenario: ctrplan.Scenario) -> Place:
    """The place of a scenario, whatever its target."""
    base = scenario.base_position_m, scenario.base_R
    key = f"{scenario.robot.sha256} {scenario.margins} {content_key(scenario.anatomy, *base)}"
    if key not in PLACED:
        while len(PLACED) >= PLACES:
            del PLACED[next(iter(PLACED))]
        PLACED[key] = Place(scenario)
    return PLACED[key]


def known(value: float) -> float | None:
    """None for what there is not."""
    return value if math.isfinite(value) else None
