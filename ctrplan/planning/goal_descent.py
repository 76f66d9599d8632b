"""Goal states with less error: configurations beside the best ones, with the tip kept where it is."""

from __future__ import annotations

import numpy as np

from ctrplan.planning.branches import configuration
from ctrplan.planning.goals import GoalState, tip_target
from ctrplan.planning.inverse_kinematics import TipSolver, TipTarget
from ctrplan.planning.motion import HOPELESS_M, MotionChecker

KEPT, TRIED = 6, 10  # of the states with the lowest bounds, random ones beside each
ROUNDS_MM = (30.0, 15.0, 7.0)  # of joint length, standard deviation of each round's random states
HEADWAY = 0.97  # of its bound below which a state takes the place of the one it came from
STEPS = 6  # of inverse kinematics


def descended(checker: MotionChecker, goals: list[GoalState], rng: np.random.Generator) -> list[GoalState]:
    """States with bounds below those of the best of `goals`; none for joint goals, or without joints to spare."""
    goal = checker.scenario.goal
    if goal.tip_m is None:
        return []
    target, space = tip_target(checker.scenario), checker.space
    solver = TipSolver(space, checker.mechanics)
    best = sorted(goals, key=lambda state: state.bound_m)[:KEPT]
    found: list[GoalState] = []
    for spread_mm in ROUNDS_MM:
        q = np.repeat([state.joints for state in best], TRIED, axis=0)
        owner = np.repeat(np.arange(len(best)), TRIED)
        near = space.wound_into_limits(q + rng.normal(size=q.shape) * spread_mm / space.weights_mm)
        fits = space.allowed_rows(near)
        back = solver.solve(TipTarget(solver.tips(q[fits])[0]), near[fits], STEPS, turned=False)
        rooms = checker.rooms([row[None] for row in back.joints])
        for k in np.flatnonzero((back.error_m < goal.tolerance_m / 2) & (rooms > HOPELESS_M)):
            state = configuration(checker, target, back.joints[k])
            on_target = state.tip_error_m <= goal.tolerance_m and state.turned_rad <= target.direction_tolerance_rad
            place = int(owner[fits][k])
            if state.valid and on_target and state.bound_m < HEADWAY * best[place].bound_m:
                best[place] = GoalState(state.joints, state.bound_m, state.tip_error_m)
                found.append(best[place])
    return [state for state in found if any(state is kept for kept in best)]
