"""One search of an OMPL planner over L-shaped motions, with everything it needs kept alive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import util as ou

from ctrplan.base.arrays import Array
from ctrplan.planning.goals.goal_state import GoalState
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.search.objective import BoundObjective
from ctrplan.planning.search.ompl_space import StateReader, state_space
from ctrplan.planning.search.validity import MotionValidity, Validity
from ctrplan.planning.search_clock import ASKED_NS
from ctrplan.planning.search_watch import SearchOver


class SearchProblem:
    """Everything OMPL needs for one search, kept alive together and released together."""

    def __init__(self, checker: MotionChecker, goals: list[GoalState], seed: int) -> None:
        """goals: states to end at, of which any will do; seed: of OMPL's random numbers, which all searches share."""
        _reseed(seed)
        self.checker = checker
        self.read = StateReader(checker.space)
        self.space = state_space(checker.space)
        self.information: Any = ob.SpaceInformation(self.space)
        self.validity = Validity(self.information, checker, self.read)
        self.motions = MotionValidity(self.information, checker, self.read)
        self.information.setStateValidityChecker(self.validity)
        self.information.setMotionValidator(self.motions)
        self.information.setup()
        self.definition: Any = ob.ProblemDefinition(self.information)
        self.definition.addStartState(self._state(checker.scenario.start))
        self.has_goal = any(checker.state(goal.joints).valid for goal in goals)
        self.goal = ob.GoalStates(self.information)
        for goal in goals:
            self.goal.addState(self._state(goal.joints))
        self.definition.setGoal(self.goal)
        targets = [self.read(self._state(goal.joints)) for goal in goals]
        self.objective = BoundObjective(self.information, checker.scenario, goals=targets, checker=checker)
        self.definition.setOptimizationObjective(self.objective)
        self.planner: Any = checker.scenario.planner.ompl_planner(self.information)
        self.planner.setProblemDefinition(self.definition)
        self.planner.setup()

    @property
    def improves(self) -> bool:
        """Whether the planner goes on improving after its first path."""
        return hasattr(self.planner, "bestCost")

    def solve(self, stop: Callable[[float], bool], *, only_first: bool) -> bool:
        """Begins or goes on until `stop`, told the best cost [mm] so far, or a first path; whether there is one.

        Every question of the planner asks `stop`, so that it outlives that by the answer to one of them at most.
        """

        def over() -> bool:
            self.checker.meter.add(ASKED_NS)
            cost = self.best_cost()
            return stop(cost) or (only_first and bool(np.isfinite(cost)))

        if not self.has_goal:
            return False  # OMPL would wait for another goal, asking whether to stop now and then
        if self.improves or only_first:
            try:
                with self.checker.watch.until(lambda: stop(self.best_cost())):
                    self.planner.solve(ob.PlannerTerminationCondition(over))
            except SearchOver:
                self._hand_over()
        return bool(self.definition.hasExactSolution())

    def _hand_over(self) -> None:
        """Has the planner hand over its best path, as it does at the end of `solve` alone."""
        if np.isfinite(self.best_cost()):
            self.planner.solve(ob.PlannerTerminationCondition(lambda: True))

    def best_cost(self) -> float:
        """Cost [mm] of the best path so far, inf without one."""
        return float(self.planner.bestCost().value()) if self.improves else np.inf

    def cost_mm(self) -> float:
        """Cost [mm] of the path there is."""
        return float(self.definition.getSolutionPath().cost(self.objective).value())

    def states(self) -> list[Array]:
        """Joint values of the best path's states."""
        path = self.definition.getSolutionPath()
        return [self.read(path.getState(k)) for k in range(path.getStateCount())]

    def corners(self) -> Array:
        """(K, m) the best path expanded into legs, with the start's own winding."""
        states = self.states()
        corners = [states[0]]
        for target in states[1:]:
            corners.extend(self.checker.space.corners(corners[-1], target, self.checker.style)[1:])
        return np.array(corners) + (self.checker.scenario.start - states[0])

    def forbid(self, reason: str) -> None:
        """Forbids the motions of the best path, which failed its certificate."""
        states = self.states()
        for a, b in zip(states[:-1], states[1:], strict=True):
            self.checker.forbid(a, b, reason)

    def _state(self, q: Array) -> Any:
        state = self.information.allocState()
        self.read.write(state, q)
        return state


def _reseed(seed: int) -> None:
    """Seeds every generator OMPL makes from here on; it warns after the first time in a process, needlessly."""
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed + 1)  # 0 would mean: take one from the clock
    ou.setLogLevel(max(level, ou.LOG_ERROR, key=lambda value: value.value))
