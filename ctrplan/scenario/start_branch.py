"""On which branch of equilibria a robot stands at its start, and along a path from there.

A homed drive counts whole turns: `turns = "absolute"` in [start]. Rotations straight from home, at the translations of
the start, then say which of several stable shapes the robot has there. They count as long as no shape snaps on the way,
neither without friction nor in its sign corners. Along a path the shape is followed (`ctrplan.mechanics.guide`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError, SolverError
from ctrplan.mechanics.equilibria import SAME_RAD, SAME_SHAPE_M, is_unique, refuse_other_kinds
from ctrplan.mechanics.guide import Guide
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathLimits
from ctrplan.scenario.joint_space import JointSpace

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

_STARTS: WeakKeyDictionary[Robot, dict[bytes, Guide | None]] = WeakKeyDictionary()


def standing(scenario: Scenario, path: Array | None = None) -> Scenario:
    """The scenario with its robot on the branch where it stands at the start, and along waypoints (K, m) from there.

    The scenario itself where that is the one that is solved at the joints by themselves, or where it is not known:
    then the start is refused (`ctrplan.certificate.other_equilibria`). What a robot was followed along elsewhere says
    nothing of this start.
    """
    robot, way = scenario.robot, scenario.start[None] if path is None else path
    theta_b, l_b = robot.drive.collars(JointSpace.of_robot(robot).straight_steps(way))
    begin = robot.guide and robot.guide.near(theta_b[0], l_b[0])
    if begin is None or max(np.abs(begin.theta_b - theta_b[0]).max(), np.abs(begin.l_b - l_b[0]).max()) > SAME_RAD:
        begin = start_guide(scenario)
    if begin is None:
        return scenario if robot.guide is None else replace(scenario, robot=robot.unguided)
    guide = begin.along(robot.unguided.mechanics, theta_b, l_b)
    return replace(scenario, robot=robot.guided(guide))


def followed(scenario: Scenario, joints: Array) -> Scenario:
    """The scenario with its robot on the branch that is solved at joints (m,) by themselves, wherever that leads to."""
    robot, here = scenario.robot, scenario.robot.drive.collars(joints)
    try:
        refuse_other_kinds(robot)
    except InputError:
        return scenario
    guide = Guide.of(robot.mechanics, *here, robot.solve(*here))
    return scenario if guide is None else replace(scenario, robot=robot.guided(guide))


def led_on(scenario: Scenario, path: Array) -> Scenario:
    """The scenario from where waypoints (K, m) end that begin where its robot stands, on the branch that they lead to.

    What is stated of the start, of friction and turns, is no longer so there.
    """
    guide, robot = standing(scenario, path).robot.guide, scenario.robot
    robot = robot.guided(guide.at(-1)) if guide else robot.unguided if robot.guide else robot
    result = replace(scenario, robot=robot, start=path[-1])
    return replace(result, start_friction="unknown", start_turns="followed", start_state=None)


def start_guide(scenario: Scenario) -> Guide | None:
    """The shape at the start where turns count and it is wound up there; None where it is not, or where that is
    unknown.
    """
    robot, joints = scenario.robot.unguided, scenario.start
    if scenario.start_turns != "absolute" or robot.n == 1:
        return None
    known = _STARTS.setdefault(robot, {})
    key = joints.tobytes() + np.float64(scenario.margins.stability).tobytes()
    if key not in known:
        known[key] = _wound(robot, joints, scenario.margins.stability)
    return known[key]


def _wound(robot: Robot, joints: Array, least_stability: float) -> Guide | None:
    home = np.where(robot.drive.is_rotation, 0.0, joints)
    theta_b, l_b = robot.drive.collars(JointSpace.of_robot(robot).straight_steps(np.array([home, joints])))
    here = theta_b[-1], l_b[-1]
    if np.allclose(np.diff(theta_b[-1] - theta_b[0]), 0.0) or is_unique(robot, here[1]):
        return None
    history = robot.history()
    try:
        refuse_other_kinds(robot)
        wound = history.follow(theta_b, l_b)
    except (InputError, SolverError):
        return None
    if np.nansum(wound.snaps) or wound.status[-1] != Status.CONVERGED:
        return None
    guide = Guide.of(robot.mechanics, *here, history.shape())
    own = robot.solve(*here).tip_m
    if guide is None or np.linalg.norm(guide.tip_m[0] - own) <= SAME_SHAPE_M:
        return None
    limits = PathLimits(stability=least_stability)
    walk = robot.mechanics.check_path(theta_b, l_b, limits=limits)
    place = walk.segment[-1] + walk.fraction[-1]
    if place < len(theta_b) - 1 or walk.status[-1] >= Status.UNSTABLE or walk.stability[-1] < least_stability:
        return None
    bound = robot.guided(guide).bound(*here)
    solved = np.array([shape.tip_m for shape in (bound.frictionless, *bound.corners)])
    walked = np.vstack([walk.tip_m[-1], walk.corner_tip_m[-1]])
    apart = max(np.linalg.norm(solved - walked, axis=1).max(), np.linalg.norm(walked[0] - guide.tip_m[0]))
    return guide if apart <= SAME_SHAPE_M else None
