"""What a robot is worth for a set of targets, and what its tolerances of manufacture may cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import NoAnswerError
from ctrplan.planning.scenario import Goal, Scenario
from ctrplan.planning.target_set.bound_slopes import RobotPair, bound_by, robot_at
from ctrplan.planning.target_set.deployment import least_stability
from ctrplan.planning.target_set.outlook import Outlook, Values
from ctrplan.planning.target_set.target_worth import (
    TargetWorth,
    aimed,
    target_checker,
    target_worth,
    within_reach,
    worth_beside,
)


class Pruned(NoAnswerError):
    """A design of the front is better, whatever the targets that were not looked at give."""


@dataclass(frozen=True)
class Search:
    """How targets are looked at."""

    starts: int = 40  # of inverse kinematics, each
    seed: int = 0
    unreached_mm: float = 10.0  # what a target counts as error that is not reached, or missed by more
    front: tuple[Values, ...] = ()  # objectives of designs that a better one has to match


@dataclass(frozen=True, eq=False)
class SetWorth:
    """T targets and what a robot makes of them; None where one is not reached."""

    targets: tuple[TargetWorth | None, ...]
    unreached_mm: float
    stability: float  # least along the motions to the targets that are reached; -inf where none is

    @property
    def reached(self) -> list[TargetWorth]:
        """Those that are."""
        return [target for target in self.targets if target is not None]

    @property
    def reach(self) -> float:
        """Share of the targets, 0 to 1."""
        return len(self.reached) / len(self.targets)

    @property
    def error_mm(self) -> float:
        """Mean distance at worst of tip and target, no target counting more than one that is not reached."""
        return math.fsum(self.errors_mm.tolist()) / len(self.targets)

    @property
    def errors_mm(self) -> Array:
        """(T,)"""
        each = [self.unreached_mm if t is None else min(t.error_m * MM_PER_M, self.unreached_mm) for t in self.targets]
        return np.array(each)

    @property
    def clearance_mm(self) -> float:
        """Least at the targets that are reached; inf in free space."""
        return min((target.clearance_m * MM_PER_M for target in self.reached), default=-math.inf)


def set_worth(scenario: Scenario, goals: Sequence[Goal], search: Search) -> SetWorth:
    """Target by target, cheap ones first. Raises Pruned as soon as a design of the front is better in any case."""
    outlook, reached = Outlook(len(goals), search.unreached_mm), 0
    possible = within_reach(scenario, goals, search.seed)
    for _ in range(possible.count(False)):
        outlook = outlook.with_target(None)
    found: list[TargetWorth | None] = [None] * len(goals)
    for k in np.flatnonzero(possible).tolist():
        if outlook.is_hopeless(reached, search.front):
            break
        there = aimed(scenario, goals[k])
        target = found[k] = target_worth(there, search.starts, search.seed + k)
        if target is None:
            outlook = outlook.with_target(None)
            continue
        reached += 1
        stability = least_stability(target_checker(there), target.joints)
        outlook = outlook.with_target(target.error_m * MM_PER_M, stability, target.clearance_m * MM_PER_M)
    if outlook.is_hopeless(reached, search.front):
        looked = len(outlook.errors_mm)
        raise Pruned(f"a design of the front is better, as {looked} of {len(goals)} targets show already.")
    return SetWorth(tuple(found), search.unreached_mm, outlook.stability if reached else -math.inf)


def error_slopes_mm(scenario: Scenario, goals: Sequence[Goal], worth: SetWorth, pairs: Sequence[RobotPair]) -> Array:
    """(P,) [mm] by which `worth.error_mm` grows for half the difference of each pair, to first order.

    Targets that are not reached, and those that count as such, stay what they are.
    """
    total = np.zeros(len(pairs))
    for goal, target in zip(goals, worth.targets, strict=True):
        if target is not None and target.error_m * MM_PER_M < worth.unreached_mm:
            total += bound_by(target_checker(aimed(scenario, goal)), target.joints, pairs)
    slopes: Array = total * MM_PER_M / len(goals)
    return slopes


@dataclass(frozen=True)
class Robust:
    """The error at worst of a robot that is made within its tolerances, and measured then."""

    error_mm: float  # never less than that of the robot as designed
    first_order_mm: float  # by the slopes alone
    reach: float  # of the same targets, at the worst corner of the tolerances


def robust_worth(
    scenario: Scenario,
    goals: Sequence[Goal],
    worth: SetWorth,
    slopes_mm: Array,
    pairs: Sequence[RobotPair],
    search: Search,
) -> Robust:
    """With the slopes (P,) of all tolerances: the corner that they lead to is solved, and what is worse counts.

    There the tip is led back to each target that was reached; where that fails, configurations are searched anew.
    """
    linear_mm = worth.error_mm + float(np.abs(slopes_mm).sum())
    made = replace(scenario, robot=robot_at(scenario.robot, pairs, np.where(slopes_mm >= 0, 1.0, -1.0)))
    beside = tuple(
        None if target is None else _remade(aimed(made, goal), target, search, k)
        for k, (goal, target) in enumerate(zip(goals, worth.targets, strict=True))
    )
    there = replace(worth, targets=beside)
    return Robust(max(linear_mm, there.error_mm), linear_mm, there.reach)


def _remade(scenario: Scenario, target: TargetWorth, search: Search, k: int) -> TargetWorth | None:
    return worth_beside(scenario, target) or target_worth(scenario, search.starts, search.seed + k)
