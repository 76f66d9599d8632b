"""When the trajectory passes what the certificate and the legs say by place: path -> time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from ctrplan.base.arrays import Array

if TYPE_CHECKING:
    from ctrplan.planning.certified import Closest
    from ctrplan.planning.planned_motion import PlannedMotion


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
