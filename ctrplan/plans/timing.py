"""When the trajectory passes what the certificate and the legs say by place, and how well an insertion follows its
leader.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.mechanics.shapes import Status

if TYPE_CHECKING:
    from ctrplan.certificate.certificate import Closest
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.plans.planned_motion import PlannedMotion
    from ctrplan.robot.robot import Robot


class Played(Protocol):
    """Samples of a motion over time: a trajectory, or what was read of one."""

    @property
    def time_s(self) -> Array:
        """(T,) rising from 0."""

    @property
    def position(self) -> Array:
        """(T, m) rad or m."""


def sample_time_s(plan: PlannedMotion) -> Array:
    """(K,) [s] when the trajectory passes the samples of the certificate."""
    return _time_at(plan, _travelled(plan, plan.certificate.samples.joints))


def place_time_s(plan: PlannedMotion, place: Closest) -> float:
    """When [s] the trajectory passes a place of closest approach."""
    return float(np.interp(place.path_mm, plan.certificate.samples.path_mm, sample_time_s(plan)))


def leg_end_s(plan: PlannedMotion) -> Array:
    """(L,) [s] when each leg ends; legs that continue in one direction are passed without rest."""
    if len(plan.trajectory.leg_end_s) == len(plan.legs):
        return plan.trajectory.leg_end_s
    return _time_at(plan, _travelled(plan, plan.waypoints)[1:])


def settling_duration_s(plan: PlannedMotion) -> float:
    """How long [s] the oscillation takes that ends the plan; 0 without one."""
    settling = plan.certificate.settling
    if settling is None:
        return 0.0
    before = leg_end_s(plan)[settling.first_leg - 1] if settling.first_leg else 0.0
    return float(plan.trajectory.duration_s - before)


def joints_at(trajectory: Played, time_s: Array) -> Array:
    """(T, m) joint values [rad, m] of the trajectory at time_s (T,) [s], linear between its samples."""
    return np.stack([np.interp(time_s, trajectory.time_s, column) for column in trajectory.position.T], axis=1)


def _time_at(plan: PlannedMotion, travelled_mm: Array) -> Array:
    return np.interp(travelled_mm, _travelled(plan, plan.trajectory.position), plan.trajectory.time_s)


def _travelled(plan: PlannedMotion, joints: Array) -> Array:
    """(K,) length [mm] of the polyline through joints (K, m), 1 rad counted as the scenario's mm_per_rad."""
    scale = np.where(plan.scenario.robot.drive.is_rotation, plan.scenario.cost.mm_per_rad, 1e3)
    steps = np.linalg.norm(np.diff(joints * scale, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


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
