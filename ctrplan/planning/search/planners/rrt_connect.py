"""Two trees, from the start and from the goals, that reach for each other."""

from __future__ import annotations

from typing import Any

from ctrplan.scenario.scenario import PlannerSettings, register
from ctrplan.storage.toml_document import Length


@register
class RRTConnect(PlannerSettings, frozen=True, kw_only=True):
    """range_mm: longest motion of a tree."""

    name: str = "RRTConnect"
    range_mm: Length = 30.0  # two trees meet by steps

    def ompl_planner(self, information: Any) -> Any:
        from ompl import geometric as og  # slow to import, and settings are read where nothing is searched

        planner = og.RRTConnect(information)
        planner.setRange(self.range_mm)
        return planner
