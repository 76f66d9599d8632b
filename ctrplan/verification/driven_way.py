"""The way that is driven: the trajectory's samples and the ends of the legs, by the joint length travelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.files.plan_file import WrittenPlan

MM_PER_RAD = 20.0  # of the length by which places are counted; it changes no claim


@dataclass(frozen=True, eq=False)
class DrivenWay:
    """R rows of joints, straight in between; a place is a share from 0 to 1 of the length travelled."""

    joints: Array  # (R, m)
    leg: Array  # (R,) legs driven until there, and the share of the next
    time_s: Array  # (R,)
    place: Array  # (R,)

    @classmethod
    def of(cls, plan: WrittenPlan) -> DrivenWay:
        """The way of a plan: trajectory and legs together."""
        corners = np.arange(len(plan.waypoints), dtype=np.float64)
        legs = np.concatenate([plan.places, corners])
        order = np.argsort(legs, kind="stable")
        joints = np.concatenate([plan.position, plan.waypoints])[order]
        times = np.concatenate([plan.time_s, np.interp(corners, plan.places, plan.time_s)])[order]
        is_rotation = plan.scenario.robot.drive.is_rotation
        steps = np.abs(np.diff(joints, axis=0)) * np.where(is_rotation, MM_PER_RAD, MM_PER_M)
        travelled = np.concatenate([[0.0], np.cumsum(steps.sum(axis=1))])
        return cls(joints, legs[order], times, travelled / max(travelled[-1], 1e-300))

    def joints_at(self, place: float) -> Array:
        """(m,) rad or m."""
        return np.array([np.interp(place, self.place, column) for column in self.joints.T])

    def leg_at(self, place: float) -> float:
        """Leg from 0, and the share of it."""
        return float(np.interp(place, self.place, self.leg))

    def time_at(self, place: float) -> float:
        """Seconds."""
        return float(np.interp(place, self.place, self.time_s))

    def places_of(self, legs: Array) -> Array:
        """(K,) places of legs and shares (K,)."""
        return np.interp(legs, self.leg, self.place)

    def until(self, place: float) -> Array:
        """(K, m) corners of the way from its start to a place, both included."""
        passed = self.leg_at(place)
        corners = [self.joints_at(float(self.places_of(np.array([k]))[0])) for k in range(int(np.ceil(passed)))]
        return np.array([*corners, self.joints_at(place)])
