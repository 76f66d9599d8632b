"""How well an insertion follows its own leader: does the body stay where the tip has been?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.mechanics.shapes import Status
from ctrplan.planning.plan_timing import joints_at

if TYPE_CHECKING:
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.robot.robot import Robot

POSES = 60
LEAST_SHARE = 0.4  # of the body's length in front of the plate at the end that came out on the way: else no insertion


def follow_the_leader_m(robot: Robot, trajectory: Trajectory) -> float | None:
    """Largest distance of the body without friction from the track of its tip so far and its shape at the start [m].

    None where the robot does not insert itself, or a pose has no solution. Solves POSES times: asked for once, when a
    plan is made, and kept in it.
    """
    bodies = _bodies(robot, trajectory)
    if bodies is None or _length(bodies[0]) > (1 - LEAST_SHARE) * _length(bodies[-1]):
        return None
    track, worst = bodies[0], 0.0
    for body in bodies[1:]:
        track = np.concatenate([track, body[-1:]])
        worst = max(worst, float(distance_from_polyline(body, track).max()))
    return worst


def _bodies(robot: Robot, trajectory: Trajectory) -> list[Array] | None:
    """Frictionless centrelines (N, 3) in front of the plate, from the plate to the tip."""
    found = []
    for joints in joints_at(trajectory, np.linspace(0.0, trajectory.duration_s, POSES)):
        shape = robot.mechanics.solve(*robot.drive.collars(joints))
        if shape.status >= Status.FAILED:
            return None
        ahead = shape.centreline_m[shape.s_m >= 0]
        found.append(ahead if len(ahead) > 1 else np.zeros((2, 3)))
    return found


def _length(line: Array) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
