"""Base poses to try, on a patch or along an opening, and what is known of each: how every target is reached from it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import MM_DIGITS, MM_PER_M, Array, shortest_rotation, unit
from ctrplan.base.package import shown
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.reach import Configuration, reach
from ctrplan.planning.room import start_trouble, tightest_place
from ctrplan.scenario.tip_solver import tip_target

if TYPE_CHECKING:
    from ctrplan.plans.plan import Plan
    from ctrplan.scenario.scenario import Goal, Scenario

DIGITS = 12  # of a quaternion in files
# A Kronecker sequence: numbers whose multiples, modulo 1, fill the cube of six dimensions evenly. They are powers of
# the inverse of the root of x^7 = x + 1, the golden ratio's like in six dimensions.
STEPS = 1.1127756842787055 ** -np.arange(1.0, 7.0)


@dataclass(frozen=True, eq=False)
class BaseFrame:
    """The robot's frame in the anatomy's."""

    position_m: Array  # (3,)
    R: Array  # (3, 3)

    @property
    def direction(self) -> Array:
        """(3,) of the z axis, along which the tubes leave the plate."""
        return np.asarray(self.R[:, 2])

    @property
    def quaternion_wxyz(self) -> Array:
        """(4,) of norm 1, w not negative."""
        return np.roll(Rotation.from_matrix(self.R).as_quat(canonical=True), 1)

    def into_robot(self, points_m: Array) -> Array:
        """Points (..., 3) of the anatomy's frame in the robot's."""
        return np.asarray((points_m - self.position_m) @ self.R)


@dataclass(frozen=True, eq=False)
class Patch:
    """A disc across the way to the targets, or what it sweeps along an opening, and a cone of directions."""

    center_m: Array  # (3,)
    along_m: Array | None  # (3,) the other end of an opening
    radius_m: float
    cone_rad: float
    aim_m: Array  # (3,) the middle of the targets, or another place to look at
    upright: Array  # (3, 3) base rotation from which others are the shortest turn
    rolls: bool  # whether tubes can't all turn together, so that it matters how the base is rolled

    def poses(self, seed: int) -> Iterator[BaseFrame]:
        """Endless, spread evenly, the same for the same seed."""
        shift = np.random.default_rng(seed).random(len(STEPS))
        for k in count():
            yield self._pose(*np.mod(shift + k * STEPS, 1.0).tolist())

    def _pose(self, out: float, around: float, tilt: float, side: float, along: float, roll: float) -> BaseFrame:
        """From six numbers in [0, 1): place on the disc, direction in the cone, place along the opening, roll."""
        position = self.center_m.copy()
        if self.along_m is not None:
            position += along * (self.along_m - self.center_m)
        across = shortest_rotation(_way(self.aim_m - position, self.upright))[:, :2]
        position += self.radius_m * math.sqrt(out) * across @ _on_circle(around)
        cosine = 1 - tilt * (1 - math.cos(self.cone_rad))  # all directions of the cone alike
        leaning = np.append(math.sqrt(max(0.0, 1 - cosine**2)) * _on_circle(side), cosine)
        way = shortest_rotation(_way(self.aim_m - position, self.upright))
        turned = turned_towards(self.upright, way @ leaning)
        if self.rolls:
            turned = turned @ Rotation.from_euler("z", 2 * math.pi * roll).as_matrix()
        return as_written(BaseFrame(position, turned))


def as_written(pose: BaseFrame) -> BaseFrame:
    """The pose in as many digits as a file is given, so that reading it back gives the same."""
    quaternion = np.roll(np.round(pose.quaternion_wxyz, DIGITS), -1)
    position_mm = np.round(pose.position_m * MM_PER_M, MM_DIGITS)
    return BaseFrame(np.multiply(position_mm, 1e-3), np.asarray(Rotation.from_quat(quaternion).as_matrix()))


def turned_towards(upright: Array, direction: Array) -> Array:
    """(3, 3) the base rotation `upright` after the shortest turn of its z axis to a direction (3,)."""
    return np.asarray(upright @ shortest_rotation(upright.T @ direction))


def middle_of(targets: Sequence[Goal]) -> Array:
    """(3,) [m] of their tips."""
    return np.asarray(np.mean([goal.tip_m for goal in targets if goal.tip_m is not None], axis=0))


def _way(away: Array, upright: Array) -> Array:
    """(3,) unit vector; where there is no way to go, the base's own axis."""
    return unit(away) if np.any(away) else np.asarray(upright[:, 2])


def _on_circle(share: float) -> Array:
    return np.array([math.cos(2 * math.pi * share), math.sin(2 * math.pi * share)])


STARTS = 200  # of inverse kinematics, for each target


@dataclass(frozen=True, eq=False)
class ReachedTarget:
    """A target seen from a base pose."""

    goal: Goal
    solutions: int  # configurations that reach it
    valid: int  # of them within all limits and margins
    best: Configuration | None  # of the valid ones, the least error at worst beside its tolerance
    reason: str  # why there is none; empty if there is one

    @property
    def worst_m(self) -> float:
        """[m] of the tip from the target at worst, whatever friction and play do; inf where it is not reached."""
        return math.inf if self.best is None else self.best.worst_m

    @property
    def share(self) -> float:
        """Error at worst in tolerances of the target, of its direction too: at most 1 where it is reached for sure."""
        return math.inf if self.best is None else _share(self.best, self.goal)


@shown
@dataclass(frozen=True, eq=False)
class BasePose:
    """A place for the robot's plate; positions and directions in the anatomy's frame."""

    scenario: Scenario  # with the robot standing there
    targets: tuple[ReachedTarget, ...]
    start_reason: str  # why the start is not valid there; empty if it is
    is_own: bool = False  # the scenario's own pose
    plan: Plan | None = None
    plan_reason: str = ""  # why there is no plan, where one was tried

    @property
    def position_m(self) -> Array:
        """(3,) of the plate's origin."""
        return self.scenario.base_position_m

    @property
    def R(self) -> Array:
        """(3, 3) takes vectors of the robot's frame to the anatomy's."""
        return self.scenario.base_R

    @property
    def direction(self) -> Array:
        """(3,) unit vector of the z axis, along which the tubes leave the plate."""
        return np.asarray(self.R[:, 2])

    @property
    def tilt_rad(self) -> float:
        """Between that axis and the straight way to the middle of the targets."""
        away = middle_of([target.goal for target in self.targets]) - self.position_m
        return math.atan2(float(np.linalg.norm(np.cross(self.direction, away))), float(self.direction @ away))

    @property
    def reached(self) -> int:
        """Targets with a valid configuration."""
        return sum(target.best is not None for target in self.targets)

    @property
    def share(self) -> float:
        """The worst target reached: its error at worst in tolerances; inf where none is reached."""
        return max((target.share for target in self.targets if target.best is not None), default=math.inf)

    @property
    def clearance_m(self) -> float:
        """Least of the configurations at the targets beyond margins, in the worst friction state; inf in free space."""
        return min((target.best.clearance_m for target in self.targets if target.best is not None), default=-math.inf)

    @property
    def reason(self) -> str:
        """What keeps the robot from a target there, or from beginning or planning; empty if nothing does."""
        if self.start_reason:
            return f"start: {self.start_reason}"
        return self.plan_reason or next((target.reason for target in self.targets if target.reason), "")

    @property
    def rank(self) -> tuple[float, ...]:
        """Less is better: a valid start, a plan where tried, targets reached, the worst of them, clearance."""
        return (bool(self.start_reason), bool(self.plan_reason), -self.reached, self.share, -self.clearance_m)


def placed(scenario: Scenario, pose: BaseFrame) -> Scenario:
    """The scenario with its robot standing at a pose."""
    return replace(scenario, base_position_m=pose.position_m, base_R=pose.R)


def base_pose(scenario: Scenario, seed: int, *, is_own: bool = False) -> BasePose:
    """Every target of a scenario by inverse kinematics, with bounds and clearances of all corners."""
    checker = MotionChecker(scenario, reserve_m=0.0)
    targets = tuple(_reached(checker, goal, seed + k) for k, goal in enumerate(scenario.targets))
    return BasePose(scenario, targets, _start_reason(checker), is_own)


def _start_reason(checker: MotionChecker) -> str:
    """Why the start is not valid, with the place where it leaves the lumen or enters a structure; empty if it is."""
    reason = checker.probe(checker.scenario.start)[0].reason
    return (start_trouble(checker) or reason) if reason else ""


def _why_not(checker: MotionChecker, way: Configuration) -> str:
    """Why a configuration is not valid, with its tightest place where room is what it lacks."""
    where = tightest_place(checker, way.joints) if way.clearance_m < checker.limits.clearance_m else ""
    return f"{way.reason}, tightest to {where}" if where else way.reason


def _share(way: Configuration, goal: Goal) -> float:
    """Errors at worst of a way to a target beside their tolerances, the larger one."""
    turned = way.worst_rad / goal.direction_tolerance_rad if goal.direction_tolerance_rad else 0.0
    return max(way.worst_m / goal.tolerance_m, turned)


def _reached(checker: MotionChecker, goal: Goal, seed: int) -> ReachedTarget:
    target = tip_target(replace(checker.scenario, goal=goal, via=()))
    result = reach(checker, target, goal.tolerance_m, np.random.default_rng(seed), STARTS)
    ways = result.configurations
    valid = [way for way in ways if way.valid]
    if valid:
        return ReachedTarget(goal, len(ways), len(valid), min(valid, key=lambda way: _share(way, goal)), "")
    if ways:
        return ReachedTarget(goal, len(ways), 0, None, _why_not(checker, max(ways, key=lambda c: c.clearance_m)))
    near = result.nearest.tip_error_m
    why = f"the nearest tip is {near * 1e3:.3g} mm away" if near > goal.tolerance_m else "the direction is not reached"
    return ReachedTarget(goal, 0, 0, None, why)
