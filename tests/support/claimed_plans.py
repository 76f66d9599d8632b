"""Plans with one leg that claim to be valid, whatever walking them found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from places import SCENARIOS

import ctrplan
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import certify
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import Leg, ReorderReport, leg_kind
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Scenario


def claiming(scenario: Scenario, end: list[float], change: Callable[[Certificate], Certificate] = lambda c: c) -> Plan:
    """A plan with one leg whose certificate says that it is valid, whatever walking it found."""
    drive = scenario.robot.drive
    points = np.array([scenario.start, np.multiply(end, [joint.si_per_unit for joint in drive.joints])])
    aimed = replace(scenario, goal=replace(scenario.goal, joints=points[1]))
    certificate = replace(certify(aimed, points), valid=True, problems=())
    return Plan(
        scenario=aimed,
        seed=0,
        planner="given path",
        style="simultaneous",
        legs=(Leg(points[0], points[1], leg_kind(drive, *points)),),
        certificate=change(certificate),
        trajectory=time_parameterise(points, drive),
        reorder=ReorderReport(0, 0, 0, 0, 0, 0, 0, 0),
        clock_s=0,
        first_found_s=0,
        first_certified_s=0,
    )


def scene(
    start_deg_mm: list[float], center_mm: list[float], radius_mm: float, margin_mm: float, *overrides: str
) -> Scenario:
    """The robot of Table II, its keys overridden, beside a sphere."""
    robot = ctrplan.load_robot(SCENARIOS / "robots" / "three_tube.toml", overrides)
    sphere = AnatomyPart(Sphere(np.multiply(center_mm, 1e-3), radius_mm * 1e-3), margin_m=margin_mm * 1e-3)
    start = np.multiply(start_deg_mm, [joint.si_per_unit for joint in robot.drive.joints])
    return replace(bare_scenario(robot), anatomy=(sphere,), start=start)
