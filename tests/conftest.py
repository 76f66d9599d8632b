"""A small plan whose legs are made by hand: two of the three-tube robot past two obstacles, certified as any plan."""

from __future__ import annotations

import gc
import os

from places import SCENARIOS

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads only fight over small matrices here

from collections.abc import Callable, Generator, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ctrplan.certificate.certify import certify
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import Leg, ReorderReport, leg_kind
from ctrplan.scenario.scenario import Scenario

OBSTACLES = [
    {"kind": "sphere", "center_mm": [0, 60, 110], "radius_mm": 15, "margin_mm": 1.0},
    {"kind": "capsule", "from_mm": [-40, -20, 90], "to_mm": [40, -25, 110], "radius_mm": 8},
]
WAYPOINTS_DEG_MM = [[0, 30, 60, -50], [0, 60, 110, -50], [0, 60, 110, -20]]

PlanMaker = Callable[..., Plan]

pytest_plugins = ["processor_times"]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    """What reading the tests makes stays; looking for garbage among it would take a fifth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def cache_of_this_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Grids and friction laws of this run, which its processes share, and none that the user has kept."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CTRPLAN_CACHE_DIR", str(folder))
        yield


@pytest.fixture(scope="session")
def make_plan() -> PlanMaker:
    """make_plan(keys of the scenario file=..., waypoints=[[deg, ..., mm], ...]) -> Plan, certified or not."""
    return build_plan


@pytest.fixture(scope="session")
def plan() -> Plan:
    """The plan that most tests look at; nobody changes it."""
    return build_plan(anatomy=OBSTACLES, goal={"tip_mm": [38, 66, 182], "tolerance_mm": 1.0})


def build_plan(waypoints: list[list[float]] = WAYPOINTS_DEG_MM, **keys: Any) -> Plan:
    scenario = _scenario(waypoints, keys)
    drive = scenario.robot.drive
    points = np.array(waypoints) * [joint.si_per_unit for joint in drive.joints]
    legs = tuple(Leg(start, end, leg_kind(drive, start, end)) for start, end in pairwise(points))
    certificate = certify(scenario, points)
    return Plan(
        scenario=scenario,
        seed=7,
        planner="BIT*",
        style="rotations before translations",
        legs=legs,
        certificate=certificate,
        trajectory=time_parameterise(points, drive),
        reorder=ReorderReport(140.2, 131.5, 2.1e-3, certificate.goal_bound_m, 310.0, 282.0, 4, 1),
        clock_s=5.0,
        first_found_s=0.31,
        first_certified_s=0.9,
        notes=("made by hand for the tests",),
    )


def _scenario(waypoints: list[list[float]], keys: dict[str, Any]) -> Scenario:
    content: dict[str, Any] = {"name": "past two ribs", "robot": "robots/three_tube.toml", **keys}
    names = load_robot(SCENARIOS / content["robot"]).drive.names
    content["start"] = dict(zip(names, waypoints[0], strict=True))
    content.setdefault("goal", {"joints": dict(zip(names, waypoints[-1], strict=True))})
    return scenario_from_dict(content, file=str(SCENARIOS / "example.toml"))
