"""Goal states: the joint goal itself, or distinct configurations whose tip reaches a target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.drive import Array
from ctrplan.errors import NoAnswerError
from ctrplan.mechanics import Status
from ctrplan.planning.motion import MotionChecker

if TYPE_CHECKING:
    from ctrplan.scenario import Scenario

SAMPLES = 3000  # zero-clearance tips looked at first
CANDIDATES = 80  # nearest of them, refined
LARGEST_SET = 24
STEP = 1e-5  # rad or m, of the finite differences
DISTINCT_MM = 5.0  # of joint length between goal states
MM_PER_M = 1e3


@dataclass(frozen=True, eq=False)
class GoalState:
    """A configuration at the goal and what it is worth."""

    joints: Array  # (m,)
    bound_m: float  # worst-case friction error of the tip
    tip_error_m: float  # frictionless tip to the target


def goal_states(checker: MotionChecker, rng: np.random.Generator) -> list[GoalState]:
    """Valid goal states, at most LARGEST_SET, the first one with the lowest bound.

    Raises NoAnswerError, saying why, when the goal is out of reach, blocked, or no state keeps the required error.
    """
    goal = checker.scenario.goal
    found = [_joint_goal(checker, goal.joints)] if goal.joints is not None else _tip_goals(checker, rng)
    found.sort(key=lambda state: state.bound_m)
    limit = checker.scenario.cost.max_error_goal_m
    kept = [state for state in found if limit is None or state.bound_m <= limit]
    if not kept:
        required, best = (limit or 0) * MM_PER_M, found[0].bound_m * MM_PER_M
        raise _no_answer(
            checker,
            f"no goal state keeps the required worst-case error of {required:g} mm, the best has {best:.2f} mm",
        )
    return _choice(checker, kept)


def _choice(checker: MotionChecker, states: list[GoalState]) -> list[GoalState]:
    """At most LARGEST_SET of the states: half of them the lowest bounds, half the shortest ways from the start."""
    if len(states) <= LARGEST_SET:
        return states
    lowest, others = states[: LARGEST_SET // 2], states[LARGEST_SET // 2 :]
    others.sort(key=lambda state: _apart_mm(checker, checker.scenario.start, state.joints))
    return lowest + others[: LARGEST_SET - len(lowest)]


def _joint_goal(checker: MotionChecker, joints: Array) -> GoalState:
    state = checker.state(joints)
    if not state.valid:
        raise _no_answer(checker, f"the goal state is not valid: {state.reason}")
    return GoalState(joints, state.end_bound_m, 0.0)


def _tip_goals(checker: MotionChecker, rng: np.random.Generator) -> list[GoalState]:
    target = target_in_robot_frame(checker.scenario)
    tolerance = checker.scenario.goal.tolerance_m
    q = checker.space.sample(rng, SAMPLES)
    q = q[np.argsort(_misses(checker, q, target))[:CANDIDATES]]
    q = _refine(checker, q, target)
    tips, status, tangents = _clearance_tips(checker, q)
    errors = np.linalg.norm(tips - target, axis=1)
    near = (errors <= tolerance) & (status != Status.FAILED)
    if not near.any():
        nearest, allowed = float(np.nanmin(errors)) * MM_PER_M, tolerance * MM_PER_M
        raise _no_answer(
            checker, f"out of reach, the nearest tip found is {nearest:.3g} mm away, goal.tolerance_mm = {allowed:g}"
        )
    turned = _turned_rad(checker.scenario, tangents)
    reached = near & (turned <= (checker.scenario.goal.direction_tolerance_rad or np.inf))
    if not reached.any():
        best = np.degrees(turned[near].min())
        raise _no_answer(checker, f"reached, but at best {best:.1f} deg from goal.direction, beyond its tolerance")
    reasons: dict[str, int] = {}
    found: list[GoalState] = []
    for k in np.flatnonzero(reached):
        state = checker.state(q[k])
        if not state.valid:
            reasons[state.reason.split(" by ")[0]] = reasons.get(state.reason, 0) + 1
        elif all(_apart_mm(checker, q[k], other.joints) > DISTINCT_MM for other in found):
            found.append(GoalState(q[k], state.end_bound_m, float(errors[k])))
    if not found:
        usual = max(reasons, key=lambda reason: reasons[reason])
        raise _no_answer(checker, f"every configuration found that reaches it is invalid, most often because {usual}")
    return found


def target_in_robot_frame(scenario: Scenario) -> Array:
    """(3,) the goal's tip position [m] in the robot's frame."""
    assert scenario.goal.tip_m is not None
    target: Array = scenario.base_R.T @ (scenario.goal.tip_m - scenario.base_position_m)
    return target


def _misses(checker: MotionChecker, q: Array, target: Array) -> Array:
    tips, _, status = checker.mechanics.tips(*checker.space.drive.collars(q))
    miss: Array = np.linalg.norm(tips - target, axis=1)
    miss[status != Status.CONVERGED] = np.inf
    return miss


def _refine(checker: MotionChecker, q: Array, target: Array) -> Array:
    """Damped Newton steps on the zero-clearance tip, then on the frictionless clearance tip with the same Jacobian."""
    for with_clearance in (False, False, False, False, False, True, True):
        tips, jacobian = _tips_and_jacobian(checker, q)
        if with_clearance:
            tips, _, _ = _clearance_tips(checker, q)
        q = _step(checker, q, target - tips, jacobian)
    return q


def _tips_and_jacobian(checker: MotionChecker, q: Array) -> tuple[Array, Array]:
    """Zero-clearance tips (K, 3) and derivatives (K, 3, m) by one-sided differences, to a side that is allowed."""
    count, m = q.shape
    moved = np.repeat(q[:, None, :], m + 1, axis=1)
    change = np.ones((count, m))
    for j in range(m):
        for step in (STEP, -STEP):
            moved[:, j + 1, j] = np.where(checker.space.allowed_rows(moved[:, j + 1]), moved[:, j + 1, j], q[:, j])
            same = moved[:, j + 1, j] == q[:, j]
            moved[same, j + 1, j] += step
        moved[:, j + 1, j] = np.where(checker.space.allowed_rows(moved[:, j + 1]), moved[:, j + 1, j], q[:, j])
        change[:, j] = moved[:, j + 1, j] - q[:, j]
    tips, _, _ = checker.mechanics.tips(*checker.space.drive.collars(moved.reshape(-1, m)))
    tips = tips.reshape(count, m + 1, 3)
    change[change == 0] = np.inf  # a joint that can move to neither side contributes nothing
    return tips[:, 0], np.swapaxes((tips[:, 1:] - tips[:, :1]) / change[:, :, None], 1, 2)


def _step(checker: MotionChecker, q: Array, miss: Array, jacobian: Array) -> Array:
    """One damped least-squares step in mm-weighted joints, at most 30 mm long, clipped to limits and nesting."""
    scaled = jacobian / checker.space.weights_mm * MM_PER_M  # mm per mm
    gram = scaled @ np.swapaxes(scaled, 1, 2) + 1e-4 * np.eye(3)
    step = np.einsum("kij,ki->kj", scaled, np.linalg.solve(gram, (miss * MM_PER_M)[:, :, None])[:, :, 0])
    length = np.linalg.norm(step, axis=1, keepdims=True)
    step *= np.minimum(1.0, 30.0 / np.maximum(length, 1e-12))
    moved = np.clip(q + step / checker.space.weights_mm, checker.space.drive.lower, checker.space.drive.upper)
    return np.where(checker.space.allowed_rows(moved)[:, None], moved, q)


def _clearance_tips(checker: MotionChecker, q: Array) -> tuple[Array, NDArray[np.int_], Array]:
    bounds = checker.mechanics.bound_many(*checker.space.drive.collars(q))
    return bounds.tip_m, bounds.status, bounds.tip_tangent


def _turned_rad(scenario: Scenario, tangents: Array) -> Array:
    """(K,) angles [rad] between tip tangents and the direction asked for; 0 if none is."""
    if scenario.goal.direction is None:
        return np.zeros(len(tangents))
    cosine = np.clip(tangents @ (scenario.base_R.T @ scenario.goal.direction), -1, 1)
    angle: Array = np.arccos(cosine)
    return angle


def _apart_mm(checker: MotionChecker, a: Array, b: Array) -> float:
    return checker.space.length_mm(checker.space.difference(a, b))


def _no_answer(checker: MotionChecker, sentence: str) -> NoAnswerError:
    scenario = checker.scenario
    if scenario.goal.tip_m is not None:
        key = f"goal.tip_mm = {[round(float(x), 3) for x in scenario.goal.tip_m * MM_PER_M]}"
    else:
        key = "goal.joints"
    return NoAnswerError(f"{scenario.path or scenario.name}: {key}: {sentence}.")
