"""The robot along a trajectory, at equal steps of its time."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.progress import Progress
from ctrplan.errors import SolverError
from ctrplan.planning.plan_timing import Played, joints_at
from ctrplan.reports.pose import Pose, pose

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


def poses_along(
    scenario: Scenario, trajectory: Played, frames: int, progress: Progress | None = None
) -> tuple[Pose, ...]:
    """`frames` poses of a trajectory, both ends included; one if it takes no time.

    Solves the model at each. Left out are poses where the model has none: a plan that is not certified may have some.
    Raises SolverError where no pose has a solution.
    """
    duration_s = float(trajectory.time_s[-1])
    times = np.linspace(0.0, duration_s, frames if duration_s > 0 else 1)
    path = []
    for k, (joints, at) in enumerate(zip(joints_at(trajectory, times), times.tolist(), strict=True)):
        if progress is not None:
            progress(k / len(times))
        with suppress(SolverError):
            path.append(pose(scenario, joints, at))
    if not path:
        raise SolverError("The model has no solution anywhere on the plan's trajectory.")
    return tuple(path)
