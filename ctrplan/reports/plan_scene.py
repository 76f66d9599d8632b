"""A plan in space: the robot along its path, solved once for all pictures and pages that draw it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import SolverError
from ctrplan.planning.plan_timing import joints_at
from ctrplan.reports.narrowest_pose import NarrowestPose, narrowest_pose
from ctrplan.reports.pose import Pose, pose, to_anatomy

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan

FRAMES = 50


@dataclass(frozen=True, eq=False)
class PlanScene:
    """A plan with the poses of its robot: all that writers need, so that none of them solves the model."""

    plan: Plan
    path: tuple[Pose, ...]  # at equal steps of the trajectory's time, both ends included; one if it takes no time
    narrowest: NarrowestPose | None = None  # in free space

    @property
    def start(self) -> Pose:
        """Where the trajectory begins."""
        return self.path[0]

    @property
    def goal(self) -> Pose:
        """Where the trajectory ends."""
        return self.path[-1]


def plan_scene(plan: Plan, frames: int = FRAMES) -> PlanScene:
    """The scene of a plan; solves the model `frames` times, and once where the robot is closest to the anatomy.

    Raises SolverError where no pose has a solution. Left out are poses where the model has none: a plan that is not
    certified may have some.
    """
    duration_s = plan.trajectory.duration_s
    times = np.linspace(0.0, duration_s, frames if duration_s > 0 else 1)
    path = []
    for joints, time_s in zip(joints_at(plan.trajectory, times), times.tolist(), strict=True):
        with suppress(SolverError):
            path.append(pose(plan.scenario, joints, time_s))
    if not path:
        raise SolverError("The model has no solution anywhere on the plan's trajectory.")
    return PlanScene(plan, tuple(path), narrowest_pose(plan))


def tip_path(plan: Plan) -> Array:
    """(K, 3) [m] the tip without friction at the certificate's samples, anatomy's frame."""
    return to_anatomy(plan.scenario, plan.certificate.samples.tip_m)


def goal_tip(plan: Plan) -> Array:
    """(3,) [m] the tip that the goal asks for, or that its joint values give, anatomy's frame."""
    goal = plan.scenario.goal
    tip: Array = goal.tip_m if goal.tip_m is not None else tip_path(plan)[-1]
    return tip
