"""Goal states with less error: down the exact derivatives of the bound, with the tip kept where it is."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.cores import cores
from ctrplan.base.units import MM_PER_M
from ctrplan.planning.goals.branches import configuration
from ctrplan.planning.goals.goal_state import GoalState, tip_target
from ctrplan.planning.goals.tip_slopes import bound_slopes
from ctrplan.planning.goals.tip_solver import TipSolver, TipTarget
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.search_clock import ROOM_NS
from ctrplan.planning.search_watch import SearchOver

STEPS = 12
FIRST_MM, LEAST_MM = 20.0, 0.5  # of joint length: the first step, and where a state is as good as down
LONGER, SHORTER = 1.5, 0.5  # the next step, after one that led lower and after one that did not
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
            found = list(pool.map(lambda joints: _goal_state(checker, joints), back.joints))
            least = [MIN_PROGRESS * trails[k][-1].bound_m for k in going]
            lower = np.array([state.bound_m < bound_m for state, bound_m in zip(found, least, strict=True)])
            moved = going[lower]
            for k, i in zip(moved.tolist(), np.flatnonzero(lower).tolist(), strict=True):
                trails[k].append(found[i])
            step_mm[going] *= np.where(lower, LONGER, SHORTER)


def _downhill(checker: MotionChecker, solver: TipSolver, q: Array) -> tuple[Array, Array]:
    """(K, m) joint motions from states q (K, m), 1 mm long, along which the bound falls fastest while the tip rests.

    Zero where it can't fall. And the zero-clearance tips (K, 3) that belong to a frictionless tip on the target.
    """
    target, weights = tip_target(checker.scenario), checker.space.weights_mm / MM_PER_M
    slopes = bound_slopes(checker, q)
    uphill, held = slopes.bound_by / weights, slopes.tip_by / weights
    along = uphill - (np.linalg.pinv(held, RANK) @ held @ uphill[:, :, None])[:, :, 0]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    falls = size > FLAT * np.linalg.norm(uphill, axis=1, keepdims=True)
    down = np.where(falls, -along / np.maximum(size, 1e-12), 0.0) / checker.space.weights_mm
    return down, solver.tips(q)[0] + target.tip_m - slopes.tip_m


def _goal_state(checker: MotionChecker, joints: Array) -> GoalState:
    """Joint values (m,) as a goal state, whose bound is infinite if they are not valid or off the target."""
    goal, target = checker.scenario.goal, tip_target(checker.scenario)
    if checker.is_definite_collision(joints):
        return GoalState(joints, np.inf, np.inf)
    found = configuration(checker, target, joints)
    on_target = found.tip_error_m <= goal.tolerance_m and found.turned_rad <= target.direction_tolerance_rad
    return GoalState(joints, found.bound_m if found.valid and on_target else np.inf, found.tip_error_m)
