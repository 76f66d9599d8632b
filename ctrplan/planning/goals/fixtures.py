"""Whether what stands at the robot's base keeps clear of the anatomy, said in words before any search begins."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.units import MM_PER_M
from ctrplan.errors import NoAnswerError

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


def refuse_blocked_fixtures(scenario: Scenario) -> None:
    """Raises NoAnswerError where a fixture is nearer to the anatomy than margins allow."""
    if trouble := fixture_trouble(scenario):
        raise NoAnswerError(f"{scenario.path or scenario.name}: {trouble}.")


def fixture_trouble(scenario: Scenario) -> str:
    """The fixture that breaks its margins most, in words; empty where all keep them."""
    found = [
        (*fixture.clearance(scenario.anatomy, scenario.base_position_m, scenario.base_R), k, fixture.name)
        for k, fixture in enumerate(scenario.fixtures, 1)
    ]
    clearance, place, k, name = min(found, key=lambda one: one[0], default=(np.inf, np.zeros(3), 0, ""))
    if clearance >= 0:
        return ""
    at = [round(float(x), 1) for x in place * MM_PER_M]
    return (
        f"fixture.{k} ({name}): is {-clearance * MM_PER_M:.2f} mm nearer to the anatomy than margins allow, at {at} mm"
    )
