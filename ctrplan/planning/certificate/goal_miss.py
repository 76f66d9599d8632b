"""How far the frictionless tip of a certified path is from where its scenario wants it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.planning.goals.goal_state import target_in_robot_frame

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


def goal_miss_m(scenario: Scenario, tip: Array) -> float:
    """[m] of a tip (3,), robot's frame, from the goal's; 0 for joint goals."""
    if scenario.goal.tip_m is None:
        return 0.0
    return float(np.linalg.norm(tip - target_in_robot_frame(scenario)))


def line_error_m(scenario: Scenario, tip_m: Array) -> float | None:
    """Largest distance of tips (K, 3), robot's frame, from the goal's line; None without a line."""
    if scenario.goal.line_m is None:
        return None
    located = scenario.located(tip_m)
    return float(distance_from_polyline(located, scenario.goal.line_m).max())


def frictionless_miss(scenario: Scenario, tip_m: Array) -> list[str]:
    """A sentence if the last of tips (K, 3) misses the goal."""
    goal, miss = scenario.goal, goal_miss_m(scenario, tip_m[-1])
    if goal.tip_m is None or miss <= goal.tolerance_m:
        return []
    miss_mm, tolerance_mm = miss * MM_PER_M, goal.tolerance_m * MM_PER_M
    return [f"The frictionless tip ends {miss_mm:.2f} mm from the target, tolerance {tolerance_mm:g} mm."]
