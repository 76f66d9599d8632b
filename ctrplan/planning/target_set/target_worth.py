"""One target: whether some configuration reaches it within limits and margins, and the one that friction harms least.

Of the configurations found, the bound of the best is led down its exact derivatives while the tip rests on the target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.goals.branches import Configuration, configuration, reach, refined
from ctrplan.planning.goals.goal_descent import descended
from ctrplan.planning.goals.goal_state import GoalState, tip_target
from ctrplan.planning.goals.tip_solver import TipSolver, TipTarget
from ctrplan.planning.motion import MotionChecker, path_limits
from ctrplan.planning.scenario import Goal, Scenario

SAMPLES = 2000  # configurations whose zero-clearance tips say what is within reach at all
POLISHED = 3  # ways of each target
FINE_M = 5e-5  # of a tip that is led onto its target
NEAR_M = 15e-3  # a target with no such tip within this is out of reach


@dataclass(frozen=True, eq=False)
class TargetWorth:
    """A target that is reached."""

    joints: Array  # (m,)
    tip_error_m: float
    bound_m: float
    clearance_m: float  # of all corners beyond the margins; inf in free space

    @property
    def error_m(self) -> float:
        """How far friction may leave the tip from the target at worst."""
        return self.tip_error_m + self.bound_m


def target_worth(scenario: Scenario, starts: int, seed: int) -> TargetWorth | None:
    """Of the scenario's goal, a tip position; None where no configuration was found from `starts` random ones."""
    checker, target = target_checker(scenario), tip_target(scenario)
    rng = np.random.default_rng(seed)
    ways = reach(checker, target, scenario.goal.tolerance_m, rng, starts).configurations
    best = _least(checker, target, [way for way in ways if way.valid])
    if best is None:
        return None
    trails = descended(checker, [GoalState(best.joints, best.bound_m, best.tip_error_m)])
    states = [configuration(checker, target, state.joints) for trail in trails for state in trail[1:]]
    return _worth(_least(checker, target, [best, *states]) or best)


def _least(checker: MotionChecker, target: TipTarget, ways: Sequence[Configuration]) -> Configuration | None:
    """The valid way that friction harms least, of the best ones and of those that lead their tips onto the target.

    Ways are found within the target's tolerance, which is no error of the robot's.
    """
    best = sorted((way for way in ways if way.valid), key=_error_m)[:POLISHED]
    if not best:
        return None
    joints = refined(checker, target, np.array([way.joints for way in best]), FINE_M)
    near = [configuration(checker, target, row) for row in joints]
    return min([*best, *(way for way in near if way.valid)], key=_error_m)


def _error_m(way: Configuration) -> float:
    return way.tip_error_m + way.bound_m


def worth_beside(scenario: Scenario, near: TargetWorth) -> TargetWorth | None:
    """Of the same target for a robot that differs a little: the tip is led back from the joints of `near`.

    None where that leads to no valid configuration.
    """
    checker, target = target_checker(scenario), tip_target(scenario)
    begin = checker.space.projected(checker.space.wound_into_limits(near.joints[None]), fallback=near.joints[None])
    if not checker.space.allowed(begin):
        return None
    joints = refined(checker, target, begin, min(FINE_M, scenario.goal.tolerance_m))[0]
    found = configuration(checker, target, joints)
    return _worth(found) if found.valid and found.tip_error_m <= scenario.goal.tolerance_m else None


def target_checker(scenario: Scenario) -> MotionChecker:
    """What tells whether a configuration keeps the scenario's own limits and margins in every corner."""
    checker = MotionChecker(scenario)
    checker.limits = path_limits(scenario)
    return checker


def within_reach(scenario: Scenario, goals: Sequence[Goal], seed: int) -> list[bool]:
    """Which goals have a zero-clearance tip somewhere near, whatever collides: a cheap bound on what is reached."""
    checker = target_checker(scenario)
    solver = TipSolver(checker.space, checker.mechanics)
    tips = solver.tips(checker.space.sample(np.random.default_rng(seed), SAMPLES))[0]
    own = np.array([tip_target(aimed(scenario, goal)).tip_m for goal in goals])
    if solver.common_rotation is not None:  # turning all tubes together brings the tip around
        tips, own = (np.column_stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]]) for p in (tips, own))
    tips = tips[~np.isnan(tips).any(axis=1)]
    return [bool(len(tips)) and bool(np.linalg.norm(tips - goal, axis=1).min() < NEAR_M) for goal in own]


def aimed(scenario: Scenario, goal: Goal) -> Scenario:
    """The scenario with one goal."""
    return replace(scenario, goal=goal, via=())


def _worth(way: Configuration) -> TargetWorth:
    return TargetWorth(way.joints, way.tip_error_m, way.bound_m, way.clearance_m)
