"""One tree from the start, rewired as it grows."""

from __future__ import annotations

from typing import Any

from ctrplan.scenario.scenario import PlannerSettings, register
from ctrplan.storage.toml_document import Fraction, Length


@register
class RRTStar(PlannerSettings, frozen=True, kw_only=True):
    """goal_bias: share of samples that are goals. range_mm: longest motion of the tree, any if None."""

    name: str = "RRT*"
    goal_bias: Fraction = 0.3  # each sample is dear, and the goal is a set of many states
    range_mm: Length | None = None  # a single tree reaches for the goal at once

    def ompl_planner(self, information: Any) -> Any:
        from ompl import geometric as og  # slow to import, and settings are read where nothing is searched

        planner = og.RRTstar(information)
        planner.setGoalBias(self.goal_bias)
        planner.setRange(information.getStateSpace().getMaximumExtent() if self.range_mm is None else self.range_mm)
        return planner
