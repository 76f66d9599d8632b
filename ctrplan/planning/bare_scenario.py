"""A scenario where only a robot is given: free space, all joints as near to zero as limits and nesting allow."""

from __future__ import annotations

import numpy as np

from ctrplan.errors import InputError
from ctrplan.planning.joint_space import JointSpace
from ctrplan.planning.planner_settings import CATALOGUE, DEFAULT
from ctrplan.planning.scenario import Goal, Scenario
from ctrplan.robot.robot import Robot


def bare_scenario(robot: Robot) -> Scenario:
    """The robot in free space, its frame the anatomy's frame; the goal is the start."""
    space, drive = JointSpace.of_robot(robot), robot.drive
    zero = np.clip(np.zeros(len(drive.joints)), drive.lower, drive.upper)
    start = space.projected(zero[None], fallback=zero[None])[0]
    if not space.allowed(start):  # `never_nests` found values; random ones find them too
        drawn = space.sample(np.random.default_rng(0), 1)
        if not len(drawn):
            raise InputError("no joint values were found that nest the tubes", file=robot.path)
        start = drawn[0]
    return Scenario(
        name=robot.name,
        robot=robot,
        base_position_m=np.zeros(3),
        base_R=np.eye(3),
        start=start,
        goal=Goal(joints=start, tip_m=None, tolerance_m=1e-3),
        planner=CATALOGUE[DEFAULT](),  # type: ignore[call-arg]  # every setting has a default
        path=robot.path,
        warnings=robot.warnings,
    )
