"""Written plans whose certificate says what a test wants it to say: nothing is walked, no certificate is computed."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.audit.audited_plan import WHOLE_WAY
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Goal, Scenario
from ctrplan.storage.toml_document import read_document

WIDE_M = 1.0  # bound that no tip leaves


def table_ii(*overrides: str) -> Robot:
    """The three-tube robot of Table II, its keys overridden."""
    return ctrplan.load_robot(SCENARIOS / "robots" / "three_tube.toml", overrides)


SPEEDS = {
    unit: {f"max_velocity_{unit}_s": v, f"max_acceleration_{unit}_s2": a, f"max_jerk_{unit}_s3": j}
    for unit, v, a, j in (("deg", 60, 240, 2400), ("mm", 10, 50, 500))
}


def rvim() -> Robot:
    """The robot ctr_2 of gym-ctr-reach (RViM, MIT), of many stable shapes; friction and clearance are ours."""
    tubes = [
        (2.39, 1.83, 0.07883294853277428, [(173, 10.8)]),
        (1.8, 1.4, 0.0245044226980004, [(161, 0.0), (114, 11.68)]),
        (1.1, 0.7, 0.004506221962492861, [(164, 0.0), (145, 13.52)]),
    ]
    content: dict[str, Any] = {
        "tube": [
            {
                "outer_diameter_mm": outer,
                "inner_diameter_mm": inner,
                "bending_stiffness_Nm2": stiffness,
                "poisson_ratio": 0.5,
                "section": [{"length_mm": mm, "curvature_x_per_m": u, "curvature_y_per_m": 0} for mm, u in sections],
            }
            for outer, inner, stiffness, sections in tubes
        ],
        "contact": [{"friction_coefficient": 0.2, "clearance_mm": gap} for gap in (0.015, 0.15)],
        "joint": [
            *({"name": f"r{k}", "moves": {"theta": row}, **SPEEDS["deg"]} for k, row in enumerate(np.eye(3).tolist())),
            *(
                {"name": f"t{k + 1}", "moves": {"l": row}, "min_mm": low, "max_mm": 0, **SPEEDS["mm"]}
                for k, (row, low) in enumerate(zip(np.eye(3).tolist(), (-165, -260, -290), strict=True))
            ),
        ],
    }  # fmt: skip
    return robot_from_dict(content)


PAIR = dict(read_document(ROBOTS / "table_5_pair.toml").content)


def bent(factor: float, opposed_deg: float = 180, **joint: Any) -> Robot:
    """The pair of Table V with so many times its precurvature, mounted so that the tubes are opposed at an angle."""
    content, turned = copy.deepcopy(PAIR), np.radians(180 - opposed_deg)
    for tube, angle in zip(content["tube"], (0.0, turned), strict=True):
        for section in tube["section"]:
            most = factor * section["curvature_y_per_m"]
            section["curvature_x_per_m"], section["curvature_y_per_m"] = -most * np.sin(angle), most * np.cos(angle)
    if joint:
        content["joint"] = [{**given, **joint} if "theta" in given["moves"] else given for given in content["joint"]]
    return robot_from_dict(content, file=str(ROBOTS / "bent.toml"))


def sphere(center_mm: Sequence[float], radius_mm: float) -> AnatomyPart:
    """A sphere to avoid, without a margin."""
    return AnatomyPart(Sphere(np.multiply(center_mm, 1e-3), radius_mm * 1e-3))


def in_si(robot: Robot, values: ArrayLike) -> Any:
    """Joint values in deg and mm, in SI."""
    return np.multiply(values, [joint.si_per_unit for joint in robot.drive.joints])


def scene_of(robot: Robot, start: ArrayLike, end: ArrayLike, *anatomy: AnatomyPart, **changes: Any) -> Scenario:
    """From joints to joints, in deg and mm, past anatomy."""
    goal = Goal(joints=in_si(robot, end), tip_m=None, tolerance_m=1e-3)
    start_si = in_si(robot, start)
    return replace(bare_scenario(robot), start=start_si, anatomy=anatomy, **{"goal": goal, **changes})


def stated(scenario: Scenario, clearance_mm: float | None, waypoints: Any = None) -> WrittenPlan:
    """The plan that drives all joints together from start to goal, or through waypoints (K, m), and says that so much
    clearance is left.

    It says nothing else that could be broken: bounds are wide, predicted errors, stability and strain not stated.
    """
    rows = np.array([scenario.start, scenario.goal.joints]) if waypoints is None else np.asarray(waypoints, dtype=float)
    trajectory = time_parameterise(rows, scenario.robot.drive)
    corners = np.arange(len(rows), dtype=np.float64)
    lengths = np.linalg.norm(np.diff(rows, axis=0), axis=1)
    places, leg = [], 0
    for row in trajectory.position:
        while leg + 1 < len(rows) - 1 and np.linalg.norm(row - rows[leg]) + 1e-12 >= lengths[leg]:
            leg += 1
        along = (row - rows[leg]) @ (rows[leg + 1] - rows[leg]) / max(lengths[leg] ** 2, 1e-300)
        places.append(leg + float(np.clip(along, 0.0, 1.0)))
    figures = dict.fromkeys(WHOLE_WAY.values())
    samples = {"joints": rows.tolist(), "bound_m": [WIDE_M] * len(rows), "predicted_m": [WIDE_M] * len(rows)}
    clearance = None if clearance_mm is None else clearance_mm * 1e-3
    certificate = {**figures, "min_clearance_m": clearance, "worst_bound_m": WIDE_M, "valid": True, "samples": samples}
    certificate |= {"targets": [{"leg": len(rows) - 2}], "start_friction": scenario.start_friction}
    content = {"certificate": certificate, "trajectory": {"period_s": None}, **origin(scenario)}
    played = trajectory.time_s, trajectory.position
    return WrittenPlan(scenario, content, rows, *played, np.array(places), corners)


def origin(scenario: Scenario) -> dict[str, Any]:
    """What a plan's content says of its scenario and robot."""
    made_of = {"scenario": scenario, "robot": scenario.robot}
    return {key: {"sha256": one.sha256, "sha256_of": one.sha256_of} for key, one in made_of.items()}


def moved_to(plan: WrittenPlan, scenario: Scenario) -> WrittenPlan:
    """The plan as if it had been made in another scenario."""
    return replace(plan, scenario=scenario, content={**plan.content, **origin(scenario)})
