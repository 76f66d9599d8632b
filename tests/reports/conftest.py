"""The scene of the plan that most tests look at, solved once, and a live view that answers."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from places import SCENARIOS

from ctrplan.files.scenario_file import load_robot_or_scenario
from ctrplan.plans.plan import Plan
from ctrplan.reports.live_server import LiveServer
from ctrplan.reports.live_state import LiveState
from ctrplan.reports.plan_scene import PlanScene, plan_scene


@pytest.fixture(scope="session")
def scene(plan: Plan) -> PlanScene:
    """Nobody changes it."""
    return plan_scene(plan)


@pytest.fixture(scope="module")
def server() -> Iterator[LiveServer]:
    """A running server of the vessel's scenario."""
    with LiveServer(LiveState(load_robot_or_scenario(SCENARIOS / "vessel.toml"))) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()
