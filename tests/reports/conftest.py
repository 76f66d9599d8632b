"""The scene of the plan that most tests look at, solved once."""

from __future__ import annotations

import pytest

from ctrplan.planning.plan import Plan
from ctrplan.reports.plan_scene import PlanScene, plan_scene


@pytest.fixture(scope="session")
def scene(plan: Plan) -> PlanScene:
    """Nobody changes it."""
    return plan_scene(plan)
