"""Goal states: the joint goal itself, or distinct configurations whose tip reaches a target, improved along the
bound's derivatives; and joint values along a line for the tip, by continuous inverse kinematics, in few legs.

A rotation without limits stands at the same place after every turn, and turns cost length and friction error. A joint
with limits counts its turns, so that whoever wants them gives it limits that allow them.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import ROOM_NS, SearchOver, cores
from ctrplan.certificate.problems import with_shares
from ctrplan.drive.drive import JOINT_ROUNDING
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.mechanics.equilibria import SAME_SHAPE_M, branches, is_unique
from ctrplan.mechanics.shapes import Status
from ctrplan.motion.checker import DEFINITE_COLLISION_M, MotionChecker
from ctrplan.planning.reach import SHORTER, Configuration, Reach, bound_slopes, configuration, distinct_rows, reach
from ctrplan.planning.room import refuse_blocked_target
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Goal
from ctrplan.scenario.tip_solver import GoalState, TipSolver, TipTarget, target_in_robot_frame, tip_target

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Goal, Scenario

STEPS = 12
FIRST_MM, LEAST_MM = 20.0, 0.5  # of joint length: the first step, and where a state is as good as down
LONGER = 1.5  # the next step, after one that led lower
MIN_PROGRESS = 0.995  # of the bound, below which a step leads lower
TIP_STEPS = 6  # of inverse kinematics, which bring the tip back after each
FLAT = 1e-6  # share of the bound's derivatives that joints can follow without moving the tip
RANK = 1e-4  # smallest singular value of the tip's derivatives, to the largest, that holds a joint

Trail = list[GoalState]


def descended(checker: MotionChecker, goals: list[GoalState]) -> list[Trail]:
    """From each goal whose bound can fall: that goal and the states on the way down, each with a lower bound.

    Neighbours in a trail are a step apart, so that who has reached one goal can often go on to the better ones. A
    direction asked for may turn within its tolerance. None for joint goals, or without joints to spare. Where the
    search is over on the way, trails end where they are.
    """
    goal = checker.scenario.goal
    if goal.tip_m is None or goal.joints is not None:
        return []
    trails = [[goal] for goal in goals]
    with suppress(SearchOver):
        _descend(checker, trails)
    return [trail for trail in trails if len(trail) > 1]


def _descend(checker: MotionChecker, trails: list[Trail]) -> None:
    """Takes the trails down, step by step together."""
    space, solver = checker.space, TipSolver(checker.space, checker.mechanics, checker.watch)
    step_mm, moved = np.full(len(trails), FIRST_MM), np.arange(len(trails))
    down, aim = np.zeros((len(trails), len(space.weights_mm))), np.zeros((len(trails), 3))
    with ThreadPoolExecutor(cores()) as pool:
        for _ in range(STEPS):
            if len(moved):
                down[moved], aim[moved] = _downhill(checker, solver, np.array([trails[k][-1].joints for k in moved]))
            going = np.flatnonzero((step_mm > LEAST_MM) & down.any(axis=1))
            if not len(going):
                break
            q = np.array([trails[k][-1].joints for k in going])
            further = space.wound_into_limits(q + step_mm[going, None] * down[going])
            back = solver.solve(TipTarget(aim[going]), space.projected(further, fallback=q), TIP_STEPS, turned=False)
            checker.meter.add(ROOM_NS * TIP_STEPS * len(going))
            result = list(pool.map(lambda joints: goal_state(checker, joints), back.joints))
            least = [MIN_PROGRESS * trails[k][-1].bound_m for k in going]
            lower = np.array([state.bound_m < bound_m for state, bound_m in zip(result, least, strict=True)])
            moved = going[lower]
            for k, i in zip(moved.tolist(), np.flatnonzero(lower).tolist(), strict=True):
                trails[k].append(result[i])
            step_mm[going] *= np.where(lower, LONGER, SHORTER)


def _downhill(checker: MotionChecker, solver: TipSolver, q: Array) -> tuple[Array, Array]:
    """(K, m) joint motions from states q (K, m), 1 mm long, along which the bound falls fastest while the tip rests.

    Zero where it can't fall. And the zero-clearance tips (K, 3) that belong to a frictionless tip on the target.
    """
    target, weights = tip_target(checker.scenario), checker.space.weights_mm / MM_PER_M
    slopes = bound_slopes(checker, q)
    uphill, tip_by = slopes.bound_by / weights, slopes.tip_by / weights
    along = uphill - (np.linalg.pinv(tip_by, RANK) @ tip_by @ uphill[:, :, None])[:, :, 0]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    falls = size > FLAT * np.linalg.norm(uphill, axis=1, keepdims=True)
    down = np.where(falls, -along / np.maximum(size, 1e-12), 0.0) / checker.space.weights_mm
    return down, solver.tips(q)[0] + target.tip_m - slopes.tip_m


def goal_state(checker: MotionChecker, joints: Array) -> GoalState:
    """Joint values (m,) as a goal state, whose bound is infinite if they are not valid or off the target."""
    goal, target = checker.scenario.goal, tip_target(checker.scenario)
    if checker.is_definite_collision(joints):
        return GoalState(joints, np.inf, np.inf)
    result = configuration(checker, target, joints)
    on_target = result.tip_error_m <= goal.tolerance_m and result.turned_rad <= target.direction_tolerance_rad
    return GoalState(joints, result.bound_m if result.valid and on_target else np.inf, result.tip_error_m)


LARGEST_SET = 24


def goal_states(checker: MotionChecker, rng: np.random.Generator) -> list[GoalState]:
    """Valid goal states, at most LARGEST_SET, the first one with the lowest bound.

    Raises NoAnswerError, saying why, when the goal is out of reach, blocked, or no state keeps the required error.
    """
    goal = checker.scenario.goal
    result = [_joint_goal(checker, goal.joints)] if goal.joints is not None else _tip_goals(checker, rng)
    result.sort(key=lambda state: state.bound_m)
    limit = checker.scenario.cost.max_error_goal_m
    kept = [state for state in result if limit is None or state.bound_m <= limit]
    if limit is not None and not kept:
        lowest = [trail[-1] for trail in descended(checker, _choice(checker, result))]
        result = sorted(result + lowest, key=lambda state: state.bound_m)
        kept = [state for state in result if state.bound_m <= limit]
    if not kept:
        required, best = (limit or 0) * MM_PER_M, result[0].bound_m * MM_PER_M
        raise _no_answer(
            checker,
            f"no goal state keeps the required worst-case error of {required:g} mm, the best has {best:.2f} mm",
        )
    return _choice(checker, kept)


def distinct(checker: MotionChecker, states: list[GoalState]) -> list[GoalState]:
    """The states, lowest bound first, without those close to one before."""
    ordered = sorted(states, key=lambda state: state.bound_m)
    return [ordered[k] for k in distinct_rows(checker, np.array([s.joints for s in ordered]), np.arange(len(ordered)))]


def _choice(checker: MotionChecker, states: list[GoalState]) -> list[GoalState]:
    """At most LARGEST_SET of the states: half of them the lowest bounds, half the shortest ways from the start."""
    if len(states) <= LARGEST_SET:
        return states
    lowest, others = states[: LARGEST_SET // 2], states[LARGEST_SET // 2 :]
    others.sort(key=lambda state: _apart_mm(checker, checker.scenario.start, state.joints))
    return lowest + others[: LARGEST_SET - len(lowest)]


def _joint_goal(checker: MotionChecker, joints: Array) -> GoalState:
    state, samples = checker.probe(joints)
    if not state.valid:
        least_m = np.nan if samples is None else float(samples.clearance_m[-1])
        reason = with_shares(checker, joints, state.reason, least_m)
        raise _no_answer(checker, f"the goal state is not valid: {reason}")
    scenario = checker.scenario
    if scenario.goal.tip_m is None:
        return GoalState(joints, state.end_bound_m, 0.0)
    assert samples is not None
    miss_m = float(np.linalg.norm(samples.tip_m[-1] - target_in_robot_frame(scenario)))
    if miss_m > scenario.goal.tolerance_m:
        meant = f"{scenario.goal.table}.{scenario.goal.tip_key}, beyond tolerance_mm"
        allowed_mm = scenario.goal.tolerance_m * MM_PER_M
        sentence = f"leads the frictionless tip to {miss_m * MM_PER_M:.2f} mm from {meant} = {allowed_mm:g}"
        raise _no_answer(checker, sentence)
    return GoalState(joints, state.end_bound_m, miss_m)


def _tip_goals(checker: MotionChecker, rng: np.random.Generator) -> list[GoalState]:
    scenario, goal = checker.scenario, checker.scenario.goal
    refuse_blocked_target(checker)
    least_m = DEFINITE_COLLISION_M + checker.limits.clearance_m
    result = reach(checker, tip_target(scenario), goal.tolerance_m, rng, least_room_m=least_m)
    if not result.configurations:
        raise _no_answer(checker, _unreached(scenario, result))
    valid = [c for c in result.configurations if c.valid]
    if not valid:
        usual = _usual_reason(checker, result.configurations)
        raise _no_answer(checker, f"every configuration found that reaches it is invalid, most often because {usual}")
    return [GoalState(c.joints, c.bound_m, c.tip_error_m) for c in valid]


def _usual_reason(checker: MotionChecker, configurations: Sequence[Configuration]) -> str:
    """The commonest one, numbers aside, with those of the configuration that has most clearance."""
    kinds = Counter(_kind(c.reason) for c in configurations)
    usual = kinds.most_common(1)[0][0]
    best = max((c for c in configurations if _kind(c.reason) == usual), key=lambda c: c.clearance_m)
    return with_shares(checker, best.joints, best.reason, best.clearance_m)


def _kind(reason: str) -> str:
    """A reason without its numbers."""
    return re.sub(r"-?\d[\d.]*", "", reason)


def _unreached(scenario: Scenario, result: Reach) -> str:
    nearest, allowed_mm = result.nearest, result.tolerance_m * MM_PER_M
    if nearest.tip_error_m <= result.tolerance_m:
        return (
            f"reached, but at best {np.degrees(nearest.turned_rad):.1f} deg from {scenario.goal.table}.direction, "
            "beyond its tolerance"
        )
    tip_mm = [round(float(x), 2) for x in (scenario.base_R @ nearest.tip_m + scenario.base_position_m) * MM_PER_M]
    away_mm = nearest.tip_error_m * MM_PER_M
    allowed = f"{scenario.goal.table}.tolerance_mm = {allowed_mm:g}"
    return f"out of reach, the nearest tip found is {away_mm:.3g} mm away at {tip_mm}, {allowed}"


def _apart_mm(checker: MotionChecker, a: Array, b: Array) -> float:
    return checker.space.length_mm(checker.space.difference(a, b))


def _no_answer(checker: MotionChecker, sentence: str) -> NoAnswerError:
    scenario = checker.scenario
    return NoAnswerError(f"{scenario.path or scenario.name}: {scenario.goal.place}: {sentence}.")


def nearest_turn(scenario: Scenario, start: Array, goal: Goal) -> Goal:
    """The goal with the unlimited rotations of its joint values at the turn nearest to start (m,); a tip goal as is."""
    if goal.joints is None:
        return goal
    return replace(goal, joints=start + JointSpace.of(scenario).difference(start, goal.joints))


def is_at_goal(scenario: Scenario) -> bool:
    """Whether the start is the scenario's joint goal, to JOINT_ROUNDING and whole turns of unlimited rotations."""
    start, goal = scenario.start, scenario.goal.joints
    return goal is not None and bool(np.all(np.abs(JointSpace.of(scenario).difference(start, goal)) <= JOINT_ROUNDING))


def turn_notes(scenario: Scenario, ends: Sequence[Array]) -> tuple[str, ...]:
    """A sentence for every unlimited rotation that ends whole turns from the joint goal; ends: (m,) at each target."""
    results = []
    for goal, end in zip(scenario.targets, ends, strict=True):
        if goal.joints is None:
            continue
        drive = scenario.robot.drive
        for joint, wraps, given, reached in zip(drive.joints, drive.wraps, goal.joints, end, strict=True):
            if wraps and abs(given - reached) > np.pi:
                given_deg, reached_deg = np.degrees([given, reached])
                results.append(
                    f"{joint.name} = {given_deg:.6g} deg is reached at {reached_deg:.6g} deg, whole turns from it; "
                    "with limits (min_deg, max_deg) the joint would count its turns."
                )
    return tuple(results)


SPACING_M = 2e-3  # of the points that are solved for
CORRECTIONS = 3  # of what a simpler model aimed at: each leaves a quarter or less of the error; a budget
SHARE = 0.5  # of the tolerance that points on the line, and straight legs between them, may use each
BETWEEN = 5  # places of a leg that are looked at
MOST_BEGINNINGS = 6
LONGEST_JUMP_MM = 25.0  # of joint length between neighbouring points: beyond it the configuration has changed over


def follow_line(checker: MotionChecker, start: Array, goal: Goal) -> tuple[Array, str]:
    """Corners (K, m) that lead the tip from joint values `start` along the goal's line; else none, and why.

    Joints move together and straight between corners. The tip without friction stays within the goal's tolerance.
    """
    assert goal.line_m is not None
    scenario = checker.scenario
    line = (goal.line_m - scenario.base_position_m) @ scenario.base_R
    points = _points(line)
    joints, shift = [start], _shift(checker, start)
    if shift is None:
        return start[None], "the mechanics solver failed at the line's beginning"
    for point in points[1:]:
        result = _next(checker, joints[-1], point, shift, SHARE * goal.tolerance_m)
        if result is None:
            at = [round(float(x) * 1e3, 1) for x in scenario.base_R @ point + scenario.base_position_m]
            return start[None], f"the tip can't follow the line beyond {at} mm"
        q, shift = result
        joints.append(q)
    q = np.array(joints)
    corners = q[_corners(checker, q, line, SHARE * goal.tolerance_m)]
    motion = checker.along(corners)
    return corners, "" if motion.valid else motion.reason


def line_beginnings(checker: MotionChecker, goals: list[GoalState], line: Goal) -> list[GoalState]:
    """Goals from which the line can be followed, at most MOST_BEGINNINGS. Raises NoAnswerError without any."""
    kept, why = [], ""
    onward = MotionChecker(replace(checker.scenario, goal=line))
    for goal in goals:
        _, failed = follow_line(onward, goal.joints, line)
        why = why or failed
        if not failed:
            kept.append(goal)
        if len(kept) == MOST_BEGINNINGS:
            break
    if not kept:
        scenario = checker.scenario
        many = f"from none of {len(goals)} configurations at its beginning; first: {why}"
        raise NoAnswerError(f"{scenario.path or scenario.name}: {line.table}.line_mm: can't be followed {many}.")
    return kept


def _points(line: Array) -> Array:
    """(K, 3) points along a polyline, its corners among them."""
    points = [line[:1]]
    for a, b in zip(line[:-1], line[1:], strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / SPACING_M)))
        points.append(a + np.linspace(0, 1, count + 1)[1:, None] * (b - a))
    return np.concatenate(points)


def _shift(checker: MotionChecker, q: Array) -> Array | None:
    """(3,) zero-clearance tip less frictionless tip with clearance; None where either fails."""
    theta_b, l_b = checker.space.drive.collars(q)
    shape = checker.mechanics.solve(theta_b, l_b)
    tip, _, status = checker.mechanics.tips(theta_b[None], l_b[None], loads=False)
    if shape.status >= Status.UNSTABLE or status[0] != Status.CONVERGED:
        return None
    shift: Array = tip[0] - shape.tip_m
    return shift


def _next(checker: MotionChecker, q: Array, point: Array, shift: Array, within_m: float) -> tuple[Array, Array] | None:
    """Joint values at the next point of the line, near q, and the shift there."""
    solver = TipSolver(checker.space, checker.mechanics)
    for _ in range(CORRECTIONS):
        result = solver.solve(TipTarget(point + shift), q[None], turned=False)
        moved = result.joints[0]
        now = _shift(checker, moved)
        if now is None or checker.space.length_mm(moved - q) > LONGEST_JUMP_MM:
            return None
        if np.linalg.norm(result.tip_m[0] - now - point) <= 0.3 * within_m:
            return moved, now
        shift = now
    return None


def _corners(checker: MotionChecker, q: Array, line: Array, within_m: float) -> list[int]:
    """Rows of q (K, m) such that straight motions between them keep the zero-clearance tip by its own track."""
    solver = TipSolver(checker.space, checker.mechanics)
    track, _ = solver.tips(q)

    def split(a: int, b: int) -> list[int]:
        if b - a < 2:
            return [b]
        share = np.linspace(0, 1, max(BETWEEN, b - a) + 2)[1:-1, None]
        tips, _ = solver.tips(q[a] + share * (q[b] - q[a]))
        off = distance_from_polyline(tips, track[a : b + 1])
        if np.all(off <= within_m):
            return [b]
        middle = (a + b) // 2
        return split(a, middle) + split(middle, b)

    return [0, *split(0, len(q) - 1)]


def shape_notes(scenario: Scenario, ends: Sequence[Array]) -> tuple[str, ...]:
    """Sentences about which of several stable shapes a plan begins and ends in; `ends` are joints (m,) at each target.

    The shape is the one that is solved at these joints by themselves: a walk that leads to another one is refused.
    """
    names = [f"At {goal.name or goal.table}" for goal in scenario.targets]
    places = zip(("At the start", *names), (scenario.start, *ends), strict=True)
    return tuple(note for where, joints in places if (note := _shape_note(scenario.robot, joints, where)))


def _shape_note(robot: Robot, joints: Array, where: str) -> str:
    theta_b, l_b = robot.drive.collars(joints)
    if robot.n == 1 or is_unique(robot, l_b):
        return ""
    try:
        each = branches(robot, theta_b, l_b)
    except InputError:  # of a kind whose equilibria are not enumerated
        return ""
    tip_m = robot.mechanics.solve(theta_b, l_b).tip_m
    by_distance = sorted(
        each, key=lambda equilibrium: float(np.linalg.norm(equilibrium.tip_m[equilibrium.first] - tip_m))
    )
    away_mm = [
        float(np.linalg.norm(equilibrium.tip_m[equilibrium.first] - tip_m)) * MM_PER_M for equilibrium in by_distance
    ]
    others = [mm for mm in away_mm if mm > SAME_SHAPE_M * MM_PER_M]
    if not others or len(others) == len(each):
        return ""
    twisted = ", ".join(f"{np.degrees(x):+.0f}" for x in by_distance[0].twist_rad[by_distance[0].first])
    return (
        f"{where} the robot stands in one of {len(others) + 1} stable shapes, that with pairs of tubes twisted by "
        f"({twisted}) deg; the nearest other one is {others[0]:.1f} mm away."
    )
