"""The worst-case friction error of the tip at the poses of a written plan, by the same rule as the plan states it.

The plan's samples have the bounds of the mesh that they were walked on, without what that mesh may be short of. What
the plan states of the goal and of the way was solved on the certificate mesh, with its allowance, and so is this.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.certificate.friction_states import bound_allowance_m
from ctrplan.plans.planned_motion import joints_at

if TYPE_CHECKING:
    from ctrplan.reports.plan_scene import WrittenMotion


def stated_error_m(motion: WrittenMotion) -> Array:
    """(F,) [m] at each pose: never above what is stated of the way, at the goal what is stated there.

    NaN where the plan has no number.
    """
    walked_m, certificate = motion.at("bound_m"), motion.plan.certificate
    robot = motion.scenario.robot
    joints = joints_at(motion.plan, np.array(motion.times_s))
    fine = robot.mechanics.bound_many(*robot.drive.collars(joints), accuracy="certificate").position_m
    fine = fine + bound_allowance_m(robot, "certificate") + np.nan_to_num(motion.at("parameter_bound_m"))
    found = np.fmax(walked_m, fine)
    if certificate["worst_bound_m"] is not None:
        found = np.minimum(found, certificate["worst_bound_m"])
    if motion.times_s[-1] == motion.plan.time_s[-1] and certificate["goal_bound_m"] is not None:
        found[-1] = certificate["goal_bound_m"]
    return np.asarray(np.where(np.isfinite(walked_m), found, np.nan))
