"""Goal states: the joint goal itself, or distinct configurations whose tip reaches a target."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import NoAnswerError
from ctrplan.planning.clearance_shares import with_shares
from ctrplan.planning.goals.branches import Configuration, Reach, distinct_rows, reach
from ctrplan.planning.goals.clearances import refuse_blocked_target
from ctrplan.planning.goals.goal_descent import descended
from ctrplan.planning.goals.goal_state import GoalState, target_in_robot_frame, tip_target
from ctrplan.planning.motion import MotionChecker

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

LARGEST_SET = 24


def goal_states(checker: MotionChecker, rng: np.random.Generator) -> list[GoalState]:
    """Valid goal states, at most LARGEST_SET, the first one with the lowest bound.

    Raises NoAnswerError, saying why, when the goal is out of reach, blocked, or no state keeps the required error.
    """
    goal = checker.scenario.goal
    found = [_joint_goal(checker, goal.joints)] if goal.joints is not None else _tip_goals(checker, rng)
    found.sort(key=lambda state: state.bound_m)
    limit = checker.scenario.cost.max_error_goal_m
    kept = [state for state in found if limit is None or state.bound_m <= limit]
    if limit is not None and not kept:
        lowest = [trail[-1] for trail in descended(checker, _choice(checker, found))]
        found = sorted(found + lowest, key=lambda state: state.bound_m)
        kept = [state for state in found if state.bound_m <= limit]
    if not kept:
        required, best = (limit or 0) * MM_PER_M, found[0].bound_m * MM_PER_M
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
    found = reach(checker, tip_target(scenario), goal.tolerance_m, rng, least_room_m=checker.definite_collision_m)
    if not found.configurations:
        raise _no_answer(checker, _unreached(scenario, found))
    valid = [c for c in found.configurations if c.valid]
    if not valid:
        usual = _usual_reason(checker, found.configurations)
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


def _unreached(scenario: Scenario, found: Reach) -> str:
    nearest, allowed_mm = found.nearest, found.tolerance_m * MM_PER_M
    if nearest.tip_error_m <= found.tolerance_m:
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
