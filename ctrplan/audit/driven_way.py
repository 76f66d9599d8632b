"""What a written trajectory makes the drive do, in time: joints that are commanded, and collars that follow late."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ctrplan.audit.allowed_robots import AllowedRobots
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.files.plan_file import WrittenPlan

MM_PER_RAD = 20.0  # of the length by which places are counted; it changes no claim
LATE_MM_PER_S = 1.0  # likewise, of time in which drives may rest


@dataclass(frozen=True, eq=False)
class DrivenWay:
    """R rows of time, straight in between; a place is a share from 0 to 1 of the length that the collars travel.

    It ends when the last drive has come to rest.
    """

    robots: AllowedRobots
    joints: Array  # (R, m)
    leg: Array  # (R,) legs driven until there, and the share of the next
    time_s: Array  # (R,)
    place: Array  # (R,)

    @classmethod
    def of(cls, plan: WrittenPlan, robots: AllowedRobots | None = None) -> DrivenWay:
        """The way of a plan: trajectory and legs together, and what follows late."""
        allowed = robots or AllowedRobots.of(plan.scenario.robot)
        corners = np.arange(len(plan.waypoints), dtype=np.float64)
        legs = np.concatenate([plan.places, corners])
        order = np.argsort(legs, kind="stable")
        joints = np.concatenate([plan.position, plan.waypoints])[order]
        times = np.concatenate([plan.time_s, np.interp(corners, plan.places, plan.time_s)])[order]
        legs = legs[order]
        if allowed.latest_s > 0:
            delays = np.unique(allowed.delays_s(np.zeros(allowed.count)))
            late = np.unique(
                np.concatenate([times, *(times + delay for delay in delays), times[-1:] + allowed.latest_s])
            )
            joints = np.column_stack([np.interp(late, times, column) for column in joints.T])
            legs, times = np.interp(late, times, legs), late
        way = cls(allowed, joints, legs, times, np.zeros(len(times)))
        commanded = way.commanded(times, np.zeros(allowed.count))
        weights = np.repeat([MM_PER_RAD, MM_PER_M], plan.scenario.robot.n)
        steps = (np.abs(np.diff(commanded, axis=0)) * weights).sum(axis=1)
        if allowed.latest_s > 0:  # drives whose delay is uncertain move while the others rest
            steps += LATE_MM_PER_S * np.diff(times)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        return cls(allowed, joints, legs, times, travelled / max(travelled[-1], 1e-300))

    def commanded(self, time_s: Array, axes: Array) -> Array:
        """(K, 2 n) where rotations [rad], then translations [m], are told to be at times (K,), as late as they follow.

        axes (A,) of the allowed robots.
        """
        delays = self.robots.delays_s(axes)
        columns = zip(delays, self._table.T, strict=True)
        return np.column_stack([np.interp(time_s - delay, self.time_s, column) for delay, column in columns])

    @cached_property
    def _table(self) -> Array:
        """(R, 2 n) what is commanded at the rows."""
        return np.hstack(self.robots.robot.drive.commanded(self.joints))

    def commanded_at(self, place: float, axes: Array) -> tuple[Array, Array]:
        """(n,) [rad], (n,) [m] at a place."""
        row = self.commanded(np.array([self.time_at(place)]), axes)[0]
        return row[: self.robots.robot.n], row[self.robots.robot.n :]

    def joints_at(self, place: float) -> Array:
        """(m,) rad or m, as they are commanded."""
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
        """(K, 2 n) where the collars are told to be on the way from its start to a place, both included."""
        places = self.places_of(np.arange(int(np.ceil(self.leg_at(place))), dtype=np.float64))
        times = np.interp([*places[places < place], place], self.place, self.time_s)
        if self.robots.latest_s > 0:
            times = np.append(self.time_s[self.time_s < times[-1]], times[-1])
        return self.commanded(times, np.zeros(self.robots.count))
