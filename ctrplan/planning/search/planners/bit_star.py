"""Batch informed trees: samples by the batch, edges in the order of what they promise."""

from __future__ import annotations

from typing import Any

from ctrplan.scenario.scenario import PlannerSettings, register
from ctrplan.storage.toml_document import Count


@register
class BITStar(PlannerSettings, frozen=True, kw_only=True):
    """samples_per_batch: states drawn between two rounds of edges."""

    name: str = "BIT*"
    samples_per_batch: Count = 100

    def ompl_planner(self, information: Any) -> Any:
        from ompl import geometric as og  # slow to import, and settings are read where nothing is searched

        planner = og.BITstar(information)
        planner.setSamplesPerBatch(self.samples_per_batch)
        return planner
