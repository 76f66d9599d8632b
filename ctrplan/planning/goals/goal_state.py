"""A goal state, and the target that it meets, as inverse kinematics takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.goals.tip_solver import TipTarget

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


@dataclass(frozen=True, eq=False)
class GoalState:
    """A configuration at the goal and what it is worth."""

    joints: Array  # (m,)
    bound_m: float  # worst-case friction error of the tip
    tip_error_m: float  # frictionless tip to the target


def tip_target(scenario: Scenario) -> TipTarget:
    """The goal's tip and direction in the robot's frame."""
    goal = scenario.goal
    direction = None if goal.direction is None else scenario.base_R.T @ goal.direction
    tolerance = np.inf if goal.direction_tolerance_rad is None else goal.direction_tolerance_rad
    return TipTarget(target_in_robot_frame(scenario), direction, tolerance)


def target_in_robot_frame(scenario: Scenario) -> Array:
    """(3,) the goal's tip position [m] in the robot's frame."""
    assert scenario.goal.tip_m is not None
    target: Array = scenario.base_R.T @ (scenario.goal.tip_m - scenario.base_position_m)
    return target
