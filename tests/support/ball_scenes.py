"""The three-tube robot with changes to its file, between balls that a path should keep clear of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from places import ROBOTS

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import Array
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import certify
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Goal, Scenario
from ctrplan.storage.toml_document import read_document

FAR_MM = [0.0, 0.0, -80.0]  # behind the plate
FRICTIONLESS = {"contact": [{"friction_coefficient": 0.0}, {"friction_coefficient": 0.0}]}


def robot(**changes: Any) -> Robot:
    content = dict(read_document(ROBOTS / "three_tube.toml").content)
    return robot_from_dict({**content, **changes}, file=str(ROBOTS / "made_up.toml"))


def joints(*deg_mm: float) -> Array:
    return np.append(np.radians(deg_mm[:3]), deg_mm[3] * 1e-3)


def scene(of: Robot, start: Array, goal: Array, *spheres: tuple[list[float], float], **given: Any) -> Scenario:
    parts = [AnatomyPart(Sphere(np.array(at) * 1e-3, r * 1e-3), "avoid", 0.0) for at, r in spheres or [(FAR_MM, 1.0)]]
    bare = bare_scenario(of)
    return replace(bare, start=start, goal=Goal(goal, None, bare.goal.tolerance_m), anatomy=tuple(parts), **given)


def certified(case: Scenario) -> Certificate:
    assert case.goal.joints is not None
    return certify(case, np.array([case.start, case.goal.joints]), restart=False)
