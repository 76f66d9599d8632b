"""What is shown of a written plan: its robot solved anew at equal steps of the time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.mechanics.shapes import Status
from ctrplan.planning.scenario import Scenario
from ctrplan.reports.narrowest_pose import NarrowestPose, narrowest_pose
from ctrplan.reports.played_poses import poses_along
from ctrplan.reports.pose import Pose


@dataclass(frozen=True, eq=False)
class WrittenMotion:
    """A plan that was read, with the poses of its robot, anatomy's frame."""

    plan: WrittenPlan
    path: tuple[Pose, ...]  # at equal steps of the time, both ends included
    tip_m: Array  # (K, 3) without friction, at the places that were certified
    narrowest: NarrowestPose | None  # in free space

    @property
    def scenario(self) -> Scenario:
        """What was planned."""
        return self.plan.scenario

    @property
    def times_s(self) -> list[float]:
        """(F,) of the poses."""
        return [pose.time_s for pose in self.path]

    @property
    def targets(self) -> dict[str, Array]:
        """Places (3,) to be reached, in their order, by their names; of joint values the place that they lead to."""
        goals, found = self.scenario.targets, {}
        for k, goal in enumerate(goals, start=1):
            name = goal.name or ("goal" if k == len(goals) else f"target {k}")
            found[name] = goal.tip_m if goal.tip_m is not None else self.path[-1].tip_m
        return found

    @property
    def step_m(self) -> float:
        """How far a station of the robot's centreline moves at most between two poses."""
        lines = [pose.tubes[-1].centreline_m for pose in self.path]
        steps = [np.linalg.norm(b - a, axis=1).max() for a, b in zip(lines[:-1], lines[1:], strict=True)]
        return float(max(steps, default=0.0))

    def at(self, name: str) -> Array:
        """(F,) a column of the certificate's samples at the times of the poses; NaN where the plan has no number."""
        if name not in self.plan.certificate["samples"]:
            return np.full(len(self.path), np.nan)
        passed_s = np.interp(self.plan.certified_places, self.plan.places, self.plan.time_s)
        return np.interp(self.times_s, passed_s, self.plan.column(name))


def written_motion(plan: WrittenPlan, steps: int, progress: Progress | None = None) -> WrittenMotion:
    """Solves the model at `steps` poses, the tip wherever it was certified, and once where the robot is closest.

    Raises SolverError where no pose has a solution.
    """
    scenario, drive = plan.scenario, plan.scenario.robot.drive
    path = poses_along(scenario, plan, steps, progress)
    joints = np.array(plan.certificate["samples"]["joints"])
    free = np.zeros((len(joints), scenario.robot.n - 1))
    tips = scenario.robot.mechanics.tips_with_friction(*drive.collars(joints), free)
    tip_m = scenario.located(tips.position_m[tips.status == Status.CONVERGED])
    return WrittenMotion(plan, path, tip_m, narrowest_pose(scenario, plan.closest))
