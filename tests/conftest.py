"""A small plan made by hand: two legs of the three-tube robot past two obstacles, checked with the real model."""

from __future__ import annotations

import os

from places import SCENARIOS

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads only fight over small matrices here

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ctrplan.anatomy.clearance_grid import exact_clearance
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.planning.plan import Certificate, CertificateSamples, Leg, Plan, ReorderReport, leg_kind
from ctrplan.planning.scenario import Scenario

OBSTACLES = [
    {"kind": "sphere", "center_mm": [0, 60, 110], "radius_mm": 15, "margin_mm": 1.0},
    {"kind": "capsule", "from_mm": [-40, -20, 90], "to_mm": [40, -25, 110], "radius_mm": 8},
]
WAYPOINTS_DEG_MM = [[0, 0, 0, -80], [0, 60, 110, -80], [0, 60, 110, -20]]
SAMPLES_PER_LEG = 12

PlanMaker = Callable[..., Plan]


@pytest.fixture(scope="session", autouse=True)
def cache_of_this_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What the user has tabulated, a bound field above all, would change what is planned."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def make_plan() -> PlanMaker:
    """make_plan(keys of the scenario file=..., waypoints=[[deg, ..., mm], ...]) -> Plan; one call into the model."""
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
    certificate = _certificate(scenario, _samples(scenario, legs), len(legs) - 1)
    return Plan(
        scenario=scenario,
        seed=7,
        planner="BIT*",
        style="rotations before translations",
        legs=legs,
        certificate=certificate,
        trajectory=time_parameterise(points, drive),
        reorder=ReorderReport(140.2, 131.5, 2.1e-3, certificate.goal_bound_m, 310.0, 282.0, 4, 1),
        search_time_s=5.0,
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


def _samples(scenario: Scenario, legs: tuple[Leg, ...]) -> CertificateSamples:
    robot = scenario.robot
    joints = np.concatenate([leg.sample(SAMPLES_PER_LEG) for leg in legs])
    collars = robot.drive.collars(joints)
    bounds = robot.mechanics.bound_many(*collars)
    scale = np.where(robot.drive.is_rotation, scenario.cost.mm_per_rad, 1e3)
    steps = np.linalg.norm(np.diff(joints, axis=0) * scale, axis=1)
    moved = np.linalg.norm(np.diff(bounds.tip_m, axis=0), axis=1)
    return CertificateSamples(
        leg=np.repeat(np.arange(len(legs)), SAMPLES_PER_LEG + 1),
        joints=joints,
        path_mm=np.concatenate([[0.0], np.cumsum(steps)]),
        bound_m=bounds.position_m,
        bound_rad=bounds.tangent_rad,
        stability=bounds.stability,
        max_strain=bounds.max_strain,
        clearance_m=np.array([_clearance(scenario, *pair) for pair in zip(*collars, strict=True)]),
        motion_m=np.concatenate([[0.0], moved]),
        tip_m=bounds.tip_m,
        released_m=bounds.position_m * 0.8,
        predicted_m=bounds.position_m / 2,
        play_m=np.zeros(len(joints)),
    )


def _clearance(scenario: Scenario, theta_b: Any, l_b: Any) -> float:
    points, radius = scenario.robot.mechanics.body(theta_b, l_b)
    in_anatomy = points @ scenario.base_R.T + scenario.base_position_m
    distance = exact_clearance(scenario.anatomy, in_anatomy.reshape(-1, 3)).reshape(len(points), -1)
    return float((distance - radius).min())


def _certificate(scenario: Scenario, samples: CertificateSamples, stops: int) -> Certificate:
    goal_m = scenario.goal.tip_m
    tip_m = scenario.base_R @ samples.tip_m[-1] + scenario.base_position_m
    error_mm = samples.bound_m * 1e3
    return Certificate(
        samples=samples,
        valid=True,
        problems=(),
        worst_bound_m=float(samples.bound_m.max()),
        goal_bound_m=float(samples.bound_m[-1]),
        goal_bound_rad=float(samples.bound_rad[-1]),
        goal_tip_error_m=0.0 if goal_m is None else float(np.linalg.norm(tip_m - goal_m)),
        error_integral_mm=float(error_mm[:-1] @ np.diff(samples.path_mm)) / scenario.cost.mm_per_rad,
        worst_predicted_m=float(samples.predicted_m.max()),
        goal_predicted_m=float(samples.predicted_m[-1]),
        released_integral_mm=float(error_mm[:-1] @ np.diff(samples.path_mm)) / scenario.cost.mm_per_rad * 0.8,
        predicted_integral_mm=float(error_mm[:-1] @ np.diff(samples.path_mm)) / scenario.cost.mm_per_rad / 2,
        goal_predicted_tip_m=samples.tip_m[-1],
        goal_predicted_spread_m=0.1e-3,
        snaps=0,
        min_clearance_m=float(samples.clearance_m.min()),
        min_stability=float(samples.stability.min()),
        max_strain=float(samples.max_strain.max()),
        length_mm=float(samples.path_mm[-1]),
        stops=stops,
        cost_mm=float(samples.path_mm[-1]) + 10e3 * float(samples.bound_m[-1]),
        spacing_m=0.49e-3,
    )
