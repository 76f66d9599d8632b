"""What a robot is worth for a set of targets: reach, error whatever friction does, stability, cost of tolerances.

Of the configurations found, the bound of the best is led down its exact derivatives while the tip rests on the target.

The core differentiates tips by the numbers of the robot and by its collars, exactly; what the numbers owe to a
parameter of the design is arithmetic, differenced between two robots. With J the derivatives of the frictionless tip
and b those of the bound, by joints q and parameters p, weighted by the joints' lengths:

    db/dp at rest = b_p - b_q J_q^+ J_p.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.errors import NoAnswerError
from ctrplan.mechanics.gradients import collar_names
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.limits import path_limits
from ctrplan.planning.goal_states import RANK, descended
from ctrplan.planning.place import OUT_OF_REACH_M
from ctrplan.planning.reach import Configuration, configuration, reach, refined
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot
from ctrplan.scenario.prediction import TIP_TOLERANCE_M
from ctrplan.scenario.scenario import Goal, Scenario
from ctrplan.scenario.tip_solver import GoalState, TipSolver, TipTarget, tip_target
from ctrplan.uncertainty.tip_slopes import friction_states

Values = Mapping[str, float]
LESS_IS_BETTER = {"error_mm": True, "robust_mm": True, "reach": False, "stability": False, "clearance_mm": False}


def dominates(a: Values, b: Values) -> bool:
    """Whether a is nowhere worse than b and somewhere better; both have the same objectives."""
    costs = [(cost(name, a[name]), cost(name, b[name])) for name in b]
    return all(x <= y for x, y in costs) and any(x < y for x, y in costs)


def cost(name: str, value: float) -> float:
    """An objective's value so that less is better."""
    return value if LESS_IS_BETTER[name] else -value


@dataclass(frozen=True)
class Outlook:
    """The best that is still possible with `count` targets: what is left is taken to be reached without any error."""

    count: int
    unreached_mm: float
    errors_mm: tuple[float, ...] = ()  # of targets that are settled, unreached_mm where they are not reached
    stability: float = math.inf
    clearance_mm: float = math.inf

    def with_target(
        self, error_mm: float | None, stability: float = math.inf, clearance_mm: float = math.inf
    ) -> Outlook:
        """After one more target; None: it is not reached."""
        lost = self.unreached_mm if error_mm is None else min(error_mm, self.unreached_mm)
        least = min(self.stability, stability), min(self.clearance_mm, clearance_mm)
        return Outlook(self.count, self.unreached_mm, (*self.errors_mm, lost), *least)

    def best(self, reached: int) -> dict[str, float]:
        """Values that no objective can be better than, `reached` of the settled targets being reached."""
        error_mm = math.fsum(self.errors_mm) / self.count
        return {
            "error_mm": error_mm,
            "robust_mm": error_mm,
            "reach": (self.count - len(self.errors_mm) + reached) / self.count,
            "stability": self.stability,
            "clearance_mm": self.clearance_mm,
        }

    def is_hopeless(self, reached: int, front: Sequence[Values]) -> bool:
        """Whether a design of the front is better than the best that this one can become."""
        best = self.best(reached)
        return any(dominates(known, {name: best[name] for name in known}) for known in front)


DENSITY = PathDensity(rotation_rad=0.5, translation_m=12e-3, motion_m=25e-3)


def least_stability(checker: MotionChecker, joints: Array) -> float:
    """The least stability along the L-shaped motion from the start to joints (m,); at most 0 where the robot snaps
    there.
    """
    corners = checker.space.corners(checker.scenario.start, joints, checker.style)
    if not checker.space.allowed(corners):
        return 0.0
    samples = checker.mechanics.check_path(*checker.space.drive.collars(corners), None, density=DENSITY)
    least = float(np.nanmin(samples.stability))
    return least if samples.status[-1] == Status.CONVERGED else min(least, 0.0)


SAMPLES = 2000  # configurations whose zero-clearance tips say what is within reach at all
POLISHED = 3  # ways of each target


@dataclass(frozen=True, eq=False)
class TargetValue:
    """A target that is reached."""

    joints: Array  # (m,)
    tip_error_m: float
    bound_m: float
    play_m: float  # how far play of the drive may move the tip besides
    clearance_m: float  # of all corners beyond the margins; inf in free space

    @property
    def error_m(self) -> float:
        """How far friction and play may leave the tip from the target at worst."""
        return self.tip_error_m + self.bound_m + self.play_m


def target_value(scenario: Scenario, starts: int, seed: int) -> TargetValue | None:
    """The value of the scenario's goal, a tip position; None where no configuration reaches it from `starts` random
    ones.
    """
    checker, target = target_checker(scenario), tip_target(scenario)
    rng = np.random.default_rng(seed)
    ways = reach(checker, target, scenario.goal.tolerance_m, rng, starts).configurations
    best = _lowest_error(checker, target, [way for way in ways if way.valid])
    if best is None:
        return None
    trails = descended(checker, [GoalState(best.joints, best.bound_m, best.tip_error_m)])
    states = [configuration(checker, target, state.joints) for trail in trails for state in trail[1:]]
    return _value(_lowest_error(checker, target, [best, *states]) or best)


def _lowest_error(checker: MotionChecker, target: TipTarget, ways: Sequence[Configuration]) -> Configuration | None:
    """The valid way that friction harms least, of the best ones and of those that lead their tips onto the target.

    Ways are found within the target's tolerance, which is no error of the robot's.
    """
    best = sorted((way for way in ways if way.valid), key=_error_m)[:POLISHED]
    if not best:
        return None
    joints = refined(checker, target, np.array([way.joints for way in best]), TIP_TOLERANCE_M)
    near = [configuration(checker, target, row) for row in joints]
    return min([*best, *(way for way in near if way.valid)], key=_error_m)


def _error_m(way: Configuration) -> float:
    return way.worst_m


def value_nearby(scenario: Scenario, near: TargetValue) -> TargetValue | None:
    """The value of the same target for a robot that differs a little: the tip is led back from the joints of `near`.

    None where that leads to no valid configuration.
    """
    checker, target = target_checker(scenario), tip_target(scenario)
    begin = checker.space.projected(checker.space.wound_into_limits(near.joints[None]), fallback=near.joints[None])
    if not checker.space.allowed(begin):
        return None
    joints = refined(checker, target, begin, min(TIP_TOLERANCE_M, scenario.goal.tolerance_m))[0]
    result = configuration(checker, target, joints)
    return _value(result) if result.valid and result.tip_error_m <= scenario.goal.tolerance_m else None


def target_checker(scenario: Scenario) -> MotionChecker:
    """What tells whether a configuration keeps the scenario's own limits and margins in every corner."""
    checker = MotionChecker(scenario)
    checker.limits = path_limits(scenario)
    return checker


def reachable(scenario: Scenario, goals: Sequence[Goal], seed: int) -> list[bool]:
    """Whether each goal has a zero-clearance tip near it, whatever collides: a cheap bound on what is reached."""
    checker = target_checker(scenario)
    solver = TipSolver(checker.space, checker.mechanics)
    tips = solver.tips(checker.space.sample(np.random.default_rng(seed), SAMPLES))[0]
    own = np.array([tip_target(with_target(scenario, goal)).tip_m for goal in goals])
    if solver.common_rotation is not None:  # turning all tubes together brings the tip around
        tips, own = (np.column_stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]]) for p in (tips, own))
    tips = tips[~np.isnan(tips).any(axis=1)]
    return [bool(len(tips)) and bool(np.linalg.norm(tips - goal, axis=1).min() < OUT_OF_REACH_M) for goal in own]


def with_target(scenario: Scenario, goal: Goal) -> Scenario:
    """The scenario with one goal."""
    return replace(scenario, goal=goal, via=())


def _value(way: Configuration) -> TargetValue:
    return TargetValue(way.joints, way.tip_error_m, way.bound_m, way.play_m, way.clearance_m)


@dataclass(frozen=True, eq=False)
class RobotPair:
    """A robot with one parameter of its design a little smaller and a little larger than it is."""

    name: str
    low: Robot
    high: Robot


def bound_by(checker: MotionChecker, joints: Array, pairs: Sequence[RobotPair]) -> Array:
    """(P,) [m] by which the bound at joints (m,) grows for half the difference of each pair, to first order.

    A number that can't be moved by itself there, because tubes end at the same place, counts as fixed.
    """
    robot = checker.scenario.robot
    names, numbers_by = _numbers(robot, pairs)
    moved_by = _collars(checker, joints, pairs)
    collars = collar_names(robot.n)
    states = friction_states(robot)
    rows = np.repeat(joints[None], len(states), axis=0)
    result = checker.mechanics.tips_with_friction(
        *checker.space.drive.collars(rows), states, parameters=[*names, *collars]
    )
    by = np.nan_to_num(result.position_by)
    by_parameters = by[..., : len(names)] @ numbers_by + by[..., len(names) :] @ moved_by
    by_joints = by[..., len(names) :] @ checker.space.drive.collars_by_joints(joints[None])[0]
    away = np.nan_to_num(result.position_m[1:] - result.position_m[0])
    size = np.linalg.norm(away, axis=1)
    k = int(np.argmax(size)) if len(size) else 0
    if not len(size) or size[k] == 0:
        return np.zeros(len(pairs))
    unit, weights = away[k] / size[k], checker.space.weights_mm / MM_PER_M
    direct, led = (unit @ (part[1 + k] - part[0]) for part in (by_parameters, by_joints))
    back = np.linalg.pinv(by_joints[0] / weights, RANK) @ by_parameters[0]
    slopes: Array = direct - (led / weights) @ back
    return slopes


def robot_at(robot: Robot, pairs: Sequence[RobotPair], share: Array) -> Robot:
    """The robot with its numbers moved by shares (P,) of half the difference of each pair; the drive stays."""
    names, by = _numbers(robot, pairs)
    moved = (value_of(robot, name) + float(step) for name, step in zip(names, by @ share, strict=True))
    return with_values(robot, dict(zip(names, moved, strict=True)))


def _numbers(robot: Robot, pairs: Sequence[RobotPair]) -> tuple[list[str], Array]:
    """Names of the numbers (N,) in which any pair differs, and half of those differences (N, P) [SI]."""
    names = _all_names(robot)
    half = [[(value_of(p.high, name) - value_of(p.low, name)) / 2 for p in pairs] for name in names]
    by = np.array(half).reshape(len(names), len(pairs))
    used = np.flatnonzero(by.any(axis=1)).tolist()
    return [names[k] for k in used], by[used]


def _all_names(robot: Robot) -> list[str]:
    """What a tip can be differentiated by that a design may change."""
    results = []
    for i, tube in enumerate(robot.tubes, start=1):
        results += [f"tube.{i}.bending_stiffness_Nm2", f"tube.{i}.poisson_ratio"]
        for k in range(1, len(tube.sections) + 1):
            results += [f"tube.{i}.section.{k}.{key}" for key in ("length_m", "curvature_x_per_m", "curvature_y_per_m")]
    for i in range(1, robot.n):
        results += [f"contact.{i}.clearance_m", f"contact.{i}.friction_coefficient"]
    return results


def _collars(checker: MotionChecker, joints: Array, pairs: Sequence[RobotPair]) -> Array:
    """(2 n, P) half of what collars differ by at joints (m,)."""
    columns = [
        (np.concatenate(p.high.drive.collars(joints)) - np.concatenate(p.low.drive.collars(joints))) / 2 for p in pairs
    ]
    return np.array(columns).reshape(len(pairs), 2 * checker.mechanics.n).T


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
class SetValue:
    """T targets and what a robot makes of them; None where one is not reached."""

    targets: tuple[TargetValue | None, ...]
    unreached_mm: float
    stability: float  # least along the motions to the targets that are reached; -inf where none is

    @property
    def reached(self) -> list[TargetValue]:
        """Targets that are reached."""
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


def set_value(scenario: Scenario, goals: Sequence[Goal], search: Search) -> SetValue:
    """Target by target, cheap ones first. Raises Pruned as soon as a design of the front is better in any case."""
    outlook, reached = Outlook(len(goals), search.unreached_mm), 0
    possible = reachable(scenario, goals, search.seed)
    for _ in range(possible.count(False)):
        outlook = outlook.with_target(None)
    results: list[TargetValue | None] = [None] * len(goals)
    for k in np.flatnonzero(possible).tolist():
        if outlook.is_hopeless(reached, search.front):
            break
        there = with_target(scenario, goals[k])
        target = results[k] = target_value(there, search.starts, search.seed + k)
        if target is None:
            outlook = outlook.with_target(None)
            continue
        reached += 1
        stability = least_stability(target_checker(there), target.joints)
        outlook = outlook.with_target(target.error_m * MM_PER_M, stability, target.clearance_m * MM_PER_M)
    if outlook.is_hopeless(reached, search.front):
        looked = len(outlook.errors_mm)
        raise Pruned(f"a design of the front is better, as {looked} of {len(goals)} targets show already.")
    return SetValue(tuple(results), search.unreached_mm, outlook.stability if reached else -math.inf)


def error_slopes_mm(scenario: Scenario, goals: Sequence[Goal], worth: SetValue, pairs: Sequence[RobotPair]) -> Array:
    """(P,) [mm] by which `worth.error_mm` grows for half the difference of each pair, to first order.

    Targets that are not reached, and those that count as such, stay what they are.
    """
    total = np.zeros(len(pairs))
    for goal, target in zip(goals, worth.targets, strict=True):
        if target is not None and target.error_m * MM_PER_M < worth.unreached_mm:
            total += bound_by(target_checker(with_target(scenario, goal)), target.joints, pairs)
    slopes: Array = total * MM_PER_M / len(goals)
    return slopes


@dataclass(frozen=True)
class Robust:
    """The error at worst of a robot that is made within its tolerances, and measured then."""

    error_mm: float  # never less than that of the robot as designed
    first_order_mm: float  # by the slopes alone
    reach: float  # of the same targets, at the worst corner of the tolerances


def robust_value(
    scenario: Scenario,
    goals: Sequence[Goal],
    worth: SetValue,
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
        None if target is None else _remade(with_target(made, goal), target, search, k)
        for k, (goal, target) in enumerate(zip(goals, worth.targets, strict=True))
    )
    there = replace(worth, targets=beside)
    return Robust(max(linear_mm, there.error_mm), linear_mm, there.reach)


def _remade(scenario: Scenario, target: TargetValue, search: Search, k: int) -> TargetValue | None:
    return value_nearby(scenario, target) or target_value(scenario, search.starts, search.seed + k)
