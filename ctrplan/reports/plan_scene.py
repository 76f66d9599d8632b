"""A plan in space: the robot along its path, solved once for all pictures and pages that draw it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ctrplan.base.arrays import Array
from ctrplan.reports.narrowest_pose import NarrowestPose, narrowest_pose
from ctrplan.reports.played_poses import poses_along
from ctrplan.reports.pose import Pose

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
    path = poses_along(plan.scenario, plan.trajectory, frames)
    return PlanScene(plan, path, narrowest_pose(plan.scenario, plan.certificate.closest))


def tip_path(plan: Plan) -> Array:
    """(K, 3) [m] the tip without friction at the certificate's samples, anatomy's frame."""
    return plan.scenario.located(plan.certificate.samples.tip_m)


def goal_tip(plan: Plan) -> Array:
    """(3,) [m] the tip that the goal asks for, or that its joint values give, anatomy's frame."""
    goal = plan.scenario.goal
    tip: Array = goal.tip_m if goal.tip_m is not None else tip_path(plan)[-1]
    return tip
