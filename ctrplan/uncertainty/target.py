"""What a target requires of the tip, how far poses of the tip are from it, and the worst case by uncertain
parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.scenario.tip_solver import angle_to
from ctrplan.uncertainty.parameters import UncertainParameters
from ctrplan.uncertainty.tip_slopes import TipSlopes, friction_states, poses_at
from ctrplan.uncertainty.worst_case import (
    FRICTION,
    REGISTRATION,
    SECOND_ORDER,
    BaseBall,
    Farthest,
    OffsetBox,
    farthest,
    shares,
)

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Goal, Scenario


@dataclass(frozen=True, eq=False)
class TargetPose:
    """A tip position with a tolerance, possibly with a direction, and with a line that leads to it."""

    tip_m: Array  # (3,)
    tolerance_m: float | None  # None: joint values were asked for, there is nothing to miss
    direction: Array | None = None  # (3,) unit vector
    direction_tolerance_rad: float | None = None
    line_m: Array | None = None  # (L, 3) corners, the last one tip_m

    @classmethod
    def of(cls, scenario: Scenario, goal: Goal, frictionless_m: Array) -> TargetPose:
        """What a goal requires of the tip; for a goal in joint values, the frictionless tip (3,) there."""
        if goal.tip_m is None:
            return cls(frictionless_m, None)
        to_robot = scenario.base_R.T

        def here(points: Array) -> Array:
            return np.asarray((points - scenario.base_position_m) @ to_robot.T)

        return cls(
            tip_m=here(goal.tip_m),
            tolerance_m=goal.tolerance_m,
            direction=None if goal.direction is None else to_robot @ goal.direction,
            direction_tolerance_rad=goal.direction_tolerance_rad,
            line_m=None if goal.line_m is None else here(goal.line_m),
        )

    def off_m(self, tip_m: Array, is_end: bool) -> Array:
        """(...) distances of tips (..., 3): from the target at its end, from its line on the way there."""
        if is_end or self.line_m is None:
            return np.asarray(np.linalg.norm(tip_m - self.tip_m, axis=-1))
        return distance_from_polyline(tip_m.reshape(-1, 3), self.line_m).reshape(tip_m.shape[:-1])

    def turned_rad(self, tangent: Array) -> Array:
        """(...) angles of tangents (..., 3) of any length from the direction; 0 without one."""
        return angle_to(tangent.reshape(-1, 3), self.direction).reshape(tangent.shape[:-1])

    def nearest_m(self, tip_m: Array, is_end: bool) -> Array:
        """(3,) the point that a tip (3,) shall be at: the target, or the nearest corner-to-corner point of its line."""
        if is_end or self.line_m is None:
            return self.tip_m
        a, along = self.line_m[:-1], np.diff(self.line_m, axis=0)
        length = np.maximum(np.sum(along**2, axis=1), np.finfo(float).tiny)
        share = np.clip(np.sum((tip_m - a) * along, axis=1) / length, 0.0, 1.0)
        points = a + share[:, None] * along
        return np.asarray(points[np.argmin(np.linalg.norm(points - tip_m, axis=1))])


@dataclass(frozen=True, eq=False)
class Misses:
    """How far M robots end from a target: positions, and tangents where it has a direction. NaN: no equilibrium."""

    off_m: Array  # (M,)
    turned_rad: Array  # (M,) zero without a direction

    @classmethod
    def worst(cls, results: list[Misses]) -> Misses:
        """The largest of several places or states, robot by robot."""
        return cls(np.max([f.off_m for f in results], axis=0), np.max([f.turned_rad for f in results], axis=0))

    def missed(self, aim: TargetPose) -> NDArray[np.bool_]:
        """(M,) off by more than the tolerance, or turned by more than that of the direction; none without one."""
        if aim.tolerance_m is None:
            return np.zeros(len(self.off_m), bool)
        return np.asarray(~(self.off_m <= aim.tolerance_m) | self.turned_away(aim))

    def turned_away(self, aim: TargetPose) -> NDArray[np.bool_]:
        """(M,) turned by more than the tolerance of the direction."""
        if aim.direction_tolerance_rad is None:
            return np.zeros(len(self.off_m), bool)
        return np.asarray(~(self.turned_rad <= aim.direction_tolerance_rad))


def quantile95(values: Array) -> float:
    """95 % are below; inf where robots without an equilibrium are among the rest."""
    return float(np.quantile(np.nan_to_num(values, nan=np.inf), 0.95, method="higher"))


@dataclass(frozen=True, eq=False)
class Stop:
    """A target, and the samples at which its tip is looked at: those along its line, its end last."""

    goal: Goal
    samples: NDArray[np.int_]  # (W,) of the path
    places: NDArray[np.int_]  # (W,) numbers of these among the samples of all stops
    play_m: float = 0.0  # how far play of the drive may move the tip
    play_rad: float = 0.0  # and turn its tangent


def end_stop(goal: Goal, sample: int) -> Stop:
    """At one sample, without play."""
    return Stop(goal, np.array([sample]), np.array([0]))


POSITION, TANGENT = slice(0, 3), slice(3, 6)  # of a pose


@dataclass(frozen=True)
class WorstCase:
    """The largest distance of a vector from the one asked for; shares of its causes add up to it."""

    size: float  # m, or the chord of an angle on the unit sphere
    given: Mapping[str, float]
    saved: Mapping[str, float]  # by how much it shrinks where a cause is known exactly
    friction_state: tuple[float, ...]
    beyond_first_order: float  # by how much the solved worst case differs from the linear one; in `size`


@dataclass(frozen=True, eq=False)
class TipVector:
    """Position [m] or tangent of the tip at one configuration in S friction states, and what it shall be."""

    parameters: UncertainParameters
    theta: Array  # (1, n) commanded
    l: Array  # (1, n)  # noqa: E741 (as in the equations)
    slopes: TipSlopes  # (1, S)
    part: slice  # POSITION or TANGENT
    target: Array  # (3,)
    base: BaseBall

    @property
    def at(self) -> Array:
        """(S, 3)."""
        return self.slopes.pose[0, :, self.part]

    @property
    def by(self) -> Array:
        """(S, 3, P)."""
        return self.slopes.pose_by[0, :, self.part]

    @cached_property
    def _farthest(self) -> Farthest:
        return self._displaced(OffsetBox.of(self.parameters), self.by, self.base)

    def worst(self, off: str, rest: Mapping[str, float]) -> WorstCase:
        """With what is added besides; `off` is what the distance without friction and errors is called."""
        result, at, box = self._farthest, self.at, OffsetBox.of(self.parameters)
        state = int(np.argmax(result.length_m))
        u, offset = result.direction[state], box.middle + box.axes @ result.signs[state]
        beyond = self._beyond(state, offset)
        given = shares(self.parameters, u, self.by[state], offset, self.base, at[state], 0.0)
        given[FRICTION] = given.get(FRICTION, 0.0) + float(u @ (at[state] - at[0]))
        given |= {off: float(u @ (at[0] - self.target)), SECOND_ORDER: beyond, **rest}
        phi = tuple(friction_states(self.parameters.robot)[state].tolist())
        kept = {name: share for name, share in given.items() if share or name == FRICTION}
        return WorstCase(float(result.length_m[state]) + beyond + sum(rest.values()), kept, self._saved(), phi, beyond)

    def _beyond(self, state: int, offset: Array) -> float:
        if not self.parameters.count:
            return 0.0
        solved = poses_at(self.parameters, offset, self.theta, self.l)[0, state, self.part]
        linear = self.at[state] + self.by[state] @ offset
        return float(np.nan_to_num(np.linalg.norm(solved - linear), nan=np.inf))

    def _saved(self) -> dict[str, float]:
        """By how much the worst case shrinks where the parameters of one title, or the base, are known exactly."""
        titles, whole = np.array(self.parameters.title), float(self._farthest.length_m.max())
        results = {}
        for title in dict.fromkeys(titles.tolist()):
            known = titles == title
            left = self._displaced(OffsetBox.of(self.parameters.measured(known)), self.by[:, :, ~known], self.base)
            results[title] = whole - float(left.length_m.max())
        if self.base != BaseBall():
            left = self._displaced(OffsetBox.of(self.parameters), self.by, BaseBall())
            results[REGISTRATION] = whole - float(left.length_m.max())
        return results

    def _displaced(self, box: OffsetBox, by: Array, base: BaseBall) -> Farthest:
        return farthest(self.at - self.target, box.displaced(by), base, self.at)
