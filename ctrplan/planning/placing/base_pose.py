"""A base pose and what is known of it: how each target is reached from there, whatever friction does."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.goals.branches import Configuration, reach
from ctrplan.planning.goals.clearances import start_trouble, tightest_place
from ctrplan.planning.goals.goal_state import tip_target
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.placing.patch import Pose, middle_of

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan
    from ctrplan.planning.scenario import Goal, Scenario

STARTS = 200  # of inverse kinematics, for each target


@dataclass(frozen=True, eq=False)
class ReachedTarget:
    """A target seen from a base pose."""

    goal: Goal
    found: int  # configurations that reach it
    valid: int  # of them within all limits and margins
    best: Configuration | None  # of the valid ones, the least error at worst
    reason: str  # why there is none; empty if there is one

    @property
    def worst_m(self) -> float:
        """[m] of the tip from the target at worst, whatever friction does; inf where it is not reached."""
        return math.inf if self.best is None else self.best.tip_error_m + self.best.bound_m

    @property
    def share(self) -> float:
        """`worst_m` in tolerances of the target: at most 1 where it is reached whatever friction does."""
        return self.worst_m / self.goal.tolerance_m


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


def placed(scenario: Scenario, pose: Pose) -> Scenario:
    """The scenario with its robot standing at a pose: no longer that of its file."""
    return replace(scenario, base_position_m=pose.position_m, base_R=pose.R, sha256="")


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


def _reached(checker: MotionChecker, goal: Goal, seed: int) -> ReachedTarget:
    target = tip_target(replace(checker.scenario, goal=goal, via=()))
    found = reach(checker, target, goal.tolerance_m, np.random.default_rng(seed), STARTS)
    ways = found.configurations
    valid = [way for way in ways if way.valid]
    if valid:
        return ReachedTarget(goal, len(ways), len(valid), min(valid, key=lambda c: c.tip_error_m + c.bound_m), "")
    if ways:
        return ReachedTarget(goal, len(ways), 0, None, _why_not(checker, max(ways, key=lambda c: c.clearance_m)))
    near = found.nearest.tip_error_m
    why = f"the nearest tip is {near * 1e3:.3g} mm away" if near > goal.tolerance_m else "the direction is not reached"
    return ReachedTarget(goal, 0, 0, None, why)
