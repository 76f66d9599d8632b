"""The search: OMPL planners over L-shaped motions with the friction bound in their cost; then reorder, certify, play."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from ctrplan.drive import Array
from ctrplan.errors import NoAnswerError
from ctrplan.planning.certify import certify
from ctrplan.planning.goals import GoalState, goal_states
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.objective import BoundObjective
from ctrplan.planning.ompl_space import MotionValidity, StateReader, Validity, state_space
from ctrplan.planning.plan import MotionStyle, Plan
from ctrplan.planning.reorder import assemble, rotations_first

if TYPE_CHECKING:
    from ctrplan.scenario import Scenario

# Planners that grow forwards only, or check every motion in the direction it is driven.
PLANNERS = {"BIT*": og.BITstar, "RRT*": og.RRTstar, "RRTConnect": og.RRTConnect}
FALLBACK_SHARE = 0.3  # of the time, for simultaneous motions when no L-shaped path was found
ATTEMPTS = 8  # searches after a path failed its certificate


@dataclass(frozen=True)
class Progress:
    """What a progress callback is told."""

    stage: str  # "search" or "certificate"
    fraction: float  # of the stage, by time or by work
    best_cost_mm: float | None  # of the best path so far


@dataclass(frozen=True, eq=False)
class _Found:
    corners: Array  # (K, m)
    first_s: float  # when the first path was found


def plan(
    scenario: Scenario,
    *,
    seed: int = 0,
    time_s: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Plan:
    """A certified plan from the scenario's start to its goal.

    Searches for `time_s` (default: the scenario's) and returns the cheapest path found, reordered, certified and
    time-parameterised. Ctrl-C ends the search early and keeps the best path. Raises NoAnswerError when start or goal are
    invalid or no path was found in time.
    """
    began = time.monotonic()
    budget = scenario.planner.time_s if time_s is None else time_s
    checker = MotionChecker(scenario)
    start = checker.state(scenario.start)
    if not start.valid:
        raise NoAnswerError(f"{scenario.path or scenario.name}: start: the start state is not valid: {start.reason}.")
    goals = goal_states(checker, np.random.default_rng(seed))
    problems: tuple[str, ...] = ()
    with _interruptible() as interrupted:
        for attempt in range(ATTEMPTS):
            found, style = _search(checker, goals, seed + 1000 * attempt, began, budget, progress, interrupted)
            result = rotations_first(checker if style == checker.style else MotionChecker(scenario, style), found.corners)
            certificate = certify(
                scenario, result.after, progress=progress and (lambda f: progress(Progress("certificate", f, None)))
            )
            if certificate.valid:
                break
            problems = certificate.problems
            _forbid(checker, found.corners, certificate.samples.leg, problems)
            if interrupted.is_set() or time.monotonic() - began > 2 * budget + 10:
                break
    if not certificate.valid:
        raise NoAnswerError(f"{scenario.path or scenario.name}: no path in time passed its certificate: {problems[0]}")
    notes = scenario.warnings
    if style == "simultaneous":
        notes += ("No path of rotations before translations was found in time; joints move simultaneously.",)
    finished = assemble(
        scenario,
        result,
        certificate,
        planner=scenario.planner.name,
        seed=seed,
        time_s=time.monotonic() - began,
        first_s=found.first_s,
        notes=notes,
    )
    return replace(finished, interrupted=interrupted.is_set())


def _search(
    checker: MotionChecker,
    goals: list[GoalState],
    seed: int,
    began: float,
    budget: float,
    progress: Callable[[Progress], None] | None,
    interrupted: threading.Event,
) -> tuple[_Found, MotionStyle]:
    """L-shaped motions for the whole time; simultaneous ones for a share of it if there was no L-shaped path."""
    found = _solve(checker, goals, seed, began, time.monotonic() + budget, progress, interrupted)
    if found is not None:
        return found, checker.style
    straight = MotionChecker(checker.scenario, "simultaneous")
    until = time.monotonic() + FALLBACK_SHARE * budget
    found = None if interrupted.is_set() else _solve(straight, goals, seed, began, until, progress, interrupted)
    if found is None:
        name = checker.scenario.path or checker.scenario.name
        raise NoAnswerError(f"{name}: planner.time_s = {budget:g} s: no valid path to any of {len(goals)} goal states was found in time.")
    return found, straight.style


def _solve(
    checker: MotionChecker,
    goals: list[GoalState],
    seed: int,
    began: float,
    until: float,
    progress: Callable[[Progress], None] | None,
    interrupted: threading.Event,
) -> _Found | None:
    """One OMPL search; the corners of its best path, expanded into legs."""
    problem = _Problem(checker, goals, seed)
    first: list[float] = []
    started = time.monotonic()
    cost_known = hasattr(problem.planner, "bestCost")

    def stop() -> bool:
        now = time.monotonic()
        cost = float(problem.planner.bestCost().value()) if cost_known else np.inf
        if not first and (np.isfinite(cost) or problem.definition.hasExactSolution()):
            first.append(now - began)
        if progress:
            share = min(1.0, (now - started) / max(until - started, 1e-9))
            progress(Progress("search", share, cost if np.isfinite(cost) else None))
        return now >= until or interrupted.is_set()

    problem.planner.solve(ob.PlannerTerminationCondition(stop))
    if not problem.definition.hasExactSolution():
        return None
    path = problem.definition.getSolutionPath()
    states = [problem.read(path.getState(k)) for k in range(path.getStateCount())]
    corners = [states[0]]
    for target in states[1:]:
        corners.extend(checker.space.corners(corners[-1], target, checker.style)[1:])
    winding = checker.scenario.start - states[0]  # whole turns that the state space does not know
    return _Found(np.array(corners) + winding, first[0] if first else time.monotonic() - began)


class _Problem:
    """Everything OMPL needs for one search, kept alive together and released together."""

    def __init__(self, checker: MotionChecker, goals: list[GoalState], seed: int) -> None:
        _reseed(seed)
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
        self.goal = ob.GoalStates(self.information)
        for goal in goals:
            self.goal.addState(self._state(goal.joints))
        self.definition.setGoal(self.goal)
        targets = [self.read(self._state(goal.joints)) for goal in goals]
        self.objective = BoundObjective(self.information, checker.scenario, goals=targets, checker=checker)
        self.definition.setOptimizationObjective(self.objective)
        self.planner: Any = PLANNERS[checker.scenario.planner.name](self.information)
        self.planner.setProblemDefinition(self.definition)
        self.planner.setup()

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


def _forbid(checker: MotionChecker, corners: Array, legs: Array, problems: tuple[str, ...]) -> None:
    """Forbids the searched motions of a path that failed its certificate."""
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        if np.array_equal(checker.space.corners(a, b, checker.style)[-1], b):
            checker.forbid(a, b, problems[0])


@contextmanager
def _interruptible() -> Iterator[threading.Event]:
    """Ctrl-C sets the event instead of raising inside a callback, where OMPL would lose the best path."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = signal.signal(signal.SIGINT, lambda *_: event.set())
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, previous)
