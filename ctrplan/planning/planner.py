"""The search: OMPL planners over L-shaped motions with the friction bound in their cost; reorder, certify, play."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from ctrplan.drive import Array
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.interrupts import interrupt_event
from ctrplan.planning.certify import certify
from ctrplan.planning.compensate import compensate
from ctrplan.planning.goals import GoalState, goal_states
from ctrplan.planning.line import follow_line, line_beginnings
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.objective import BoundObjective
from ctrplan.planning.ompl_space import StateReader, state_space
from ctrplan.planning.plan import ENDED_BY_TIME, Certificate, Compensation, MotionStyle, Plan, checked_search
from ctrplan.planning.reorder import Reordered, assemble, least_error
from ctrplan.planning.retreat import RoadmapSearch, promising, retreat_roadmap
from ctrplan.planning.room import refuse_impossible_margins, start_trouble
from ctrplan.planning.settle import settle
from ctrplan.planning.tour import joined_certificates
from ctrplan.planning.validity import MotionValidity, Validity

if TYPE_CHECKING:
    from ctrplan.planning.bound_field import BoundField
    from ctrplan.scenario import Scenario

# Planners that grow forwards only, or check every motion in the direction it is driven.
PLANNERS = {"BIT*": og.BITstar, "RRT*": og.RRTstar, "RRTConnect": og.RRTConnect}
FIRST_SHARE, ROADMAP_SHARE = 0.5, 0.4  # of the time by which a first path, and the cheapest, of the roadmap is sought
LEAST_SHARE = 0.25  # of the time for sampling, however long the roadmap took
FALLBACK_SHARE = 0.3  # of the time, for simultaneous motions when no L-shaped path was found
# Longest motion of a tree; two trees meet by steps, a single one reaches for the goal at once.
RANGE_MM = {"RRTConnect": 30.0}
GOAL_BIAS = 0.3  # of a tree's samples: each is dear, and the goal is a set of many states
ATTEMPTS = 8  # searches after a path failed its certificate
LATEST = 2.0  # times the budget: no further attempt begins after it


@dataclass(frozen=True)
class Progress:
    """What a progress callback is told."""

    stage: str  # "search" or "certificate"
    fraction: float  # of the stage, by time or by work
    best_cost_mm: float | None  # of the best path so far


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A path that passed its certificate."""

    result: Reordered
    certificate: Certificate
    found_s: float  # since planning began
    certified_s: float


Report = Callable[[Progress], None]


def plan(
    scenario: Scenario,
    *,
    seed: int = 0,
    time_s: float | None = None,
    progress: Report | None = None,
    interrupted: threading.Event | None = None,
    bound_field: BoundField | None = None,
    compensated: bool = False,
) -> Plan:
    """A certified plan from the scenario's start to its goal.

    With the robot's `bound_field` the search looks bounds up instead of solving; certificates never do. With the
    scenario's planner.settle = "oscillate" the plan ends with an oscillation that releases friction; `compensated`
    moves the joints at its end so that the predicted tip arrives, not the frictionless one.

    The first path found is certified at once, better ones are sought until `time_s` (default: the scenario's) is up.
    Ctrl-C, or setting `interrupted`, ends the search early and keeps the best. Raises NoAnswerError when start or goal
    are invalid or no path was found in time, KeyboardInterrupt when it was interrupted before there was a path.
    """
    if compensated and (scenario.goal.tip_m is None or scenario.goal.line_m is not None):
        rule = "is no single tip position (tip_mm), which compensation needs"
        raise InputError(rule, file=scenario.path, key="goal")
    began = time.monotonic()
    budget = checked_search(seed, scenario.planner.time_s if time_s is None else time_s)
    refuse_impossible_margins(scenario)
    start, _ = MotionChecker(scenario).probe(scenario.start)
    if not start.valid:
        reason = start_trouble(MotionChecker(scenario)) or start.reason
        raise NoAnswerError(f"{scenario.path or scenario.name}: start: the start state is not valid: {reason}.")
    with interrupt_event(interrupted) as interrupted:
        stages = _stages(scenario, seed, began, budget, progress or (lambda _: None), interrupted, bound_field)
        finish = _finish(scenario, stages[-1][1], compensated, progress or (lambda _: None))
    notes: tuple[str, ...] = (*scenario.warnings, ENDED_BY_TIME)
    if bound_field is not None:
        notes += (f"Searched with the robot's bound field {bound_field.key}.",)
    paths = [best.result for _, best in stages]
    if any(path.on_line for path in paths):
        notes += ("Along the line, joints move simultaneously.",)
    if any(path.style == "simultaneous" and not path.on_line for path in paths):
        notes += ("No path of rotations before translations was found in time; joints move simultaneously.",)
    finished = assemble(
        scenario,
        paths,
        joined_certificates([*(best.certificate for _, best in stages[:-1]), finish.certificate]),
        planner=scenario.planner.name,
        seed=seed,
        time_s=time.monotonic() - began,
        first_found_s=stages[-1][0].found_s,
        first_certified_s=stages[-1][0].certified_s,
        notes=(*notes, *finish.notes),
        end=finish.corners,
        compensation=finish.compensation,
    )
    return replace(finished, interrupted=interrupted.is_set())


def _stages(
    scenario: Scenario,
    seed: int,
    began: float,
    budget: float,
    report: Report,
    interrupted: threading.Event,
    bound_field: BoundField | None,
) -> list[tuple[_Candidate, _Candidate]]:
    """The first and the best certified path to each target, from where the one before ended."""
    found: list[tuple[_Candidate, _Candidate]] = []
    start, targets = scenario.start, scenario.targets
    for k, goal in enumerate(targets):
        stage = replace(scenario, start=start, goal=goal, via=())
        checker = MotionChecker(stage, bound_field=bound_field)
        if goal.line_m is not None:
            found.append(_along_line(checker, began))
        else:
            goals = goal_states(checker, np.random.default_rng(seed + k))
            if k + 1 < len(targets) and targets[k + 1].line_m is not None:
                goals = line_beginnings(checker, goals, targets[k + 1])
            share = max(budget / len(targets), 0.0)
            found.append(_Work(checker, goals, seed, began, share, report, interrupted).run())
        start = found[-1][1].result.after[-1]
    return found


def _along_line(checker: MotionChecker, began: float) -> tuple[_Candidate, _Candidate]:
    """The line's own path, certified. Raises NoAnswerError where it fails."""
    scenario = checker.scenario
    corners, failed = follow_line(checker, scenario.start, scenario.goal)
    found_s = time.monotonic() - began
    certificate = None if failed else certify(scenario, corners)
    if certificate is None or not certificate.valid:
        why = failed or (certificate.problems[0] if certificate else "")
        raise NoAnswerError(f"{scenario.path or scenario.name}: line_mm: {why.rstrip('.')}.")
    motion = checker.along(corners)
    result = Reordered(corners, corners, motion, motion, "simultaneous", on_line=True)
    candidate = _Candidate(result, certificate, found_s, time.monotonic() - began)
    return candidate, candidate


@dataclass(frozen=True, eq=False)
class _Finish:
    """What becomes of the way to the last target after the search."""

    corners: Array  # (K, m)
    certificate: Certificate
    compensation: Compensation | None
    notes: tuple[str, ...]


def _finish(scenario: Scenario, best: _Candidate, compensated: bool, report: Report) -> _Finish:
    """Settles and compensates the way to the last target where that is asked for."""
    corners, certificate = best.result.after, best.certificate
    checker = MotionChecker(replace(scenario, start=corners[0], via=()))
    notes: tuple[str, ...] = ()

    def progress(fraction: float) -> None:
        report(Progress("certificate", fraction, certificate.cost_mm))

    if scenario.planner.settle == "oscillate":
        settled = settle(checker, corners, certificate, progress=progress)
        corners, certificate, notes = settled.corners, settled.certificate, (settled.note,) if settled.note else ()
    if not compensated:
        return _Finish(corners, certificate, None, notes)
    corners, certificate, compensation = compensate(checker, corners, certificate, progress=progress)
    return _Finish(corners, certificate, compensation, notes)


@dataclass(eq=False)
class _Work:
    """Searches, certifies and searches on, until time is up."""

    checker: MotionChecker
    goals: list[GoalState]
    seed: int
    began: float
    budget: float
    report: Report
    interrupted: threading.Event
    failure: str = ""  # of the last certificate
    first: _Candidate | None = None  # that was certified
    best: _Candidate | None = None

    def run(self) -> tuple[_Candidate, _Candidate]:
        """The first and the best certified path."""
        began = time.monotonic()
        self._withdraw(began)
        self._sample(began)
        if self.first is not None and self.best is not None:
            return self.first, self.best
        if self.interrupted.is_set():
            raise KeyboardInterrupt
        name = self.checker.scenario.path or self.checker.scenario.name
        if self.failure:
            raise NoAnswerError(f"{name}: no path in time passed its certificate: {self.failure}")
        outcome = f"no valid path to any of {len(self.goals)} goal states was found in time"
        raise NoAnswerError(f"{name}: planner.time_s = {self.budget:g} s: {outcome}.")

    def _withdraw(self, began: float) -> None:
        """Paths along the roadmap of `retreat.py`: soon a first one, then the cheapest."""
        goals = promising(self.checker, self.goals)
        search = RoadmapSearch(self.checker, retreat_roadmap(self.checker, goals), goals)
        for shy, share in ((True, FIRST_SHARE), (False, ROADMAP_SHARE)):
            while self.best is None or not shy:
                states = search.path(self._stopper(began, began + share * self.budget), shy=shy)
                if states is None:
                    break
                failed = self._certified(self.checker, self._expanded(states))
                if not failed:
                    break
                search.forbid(states, failed)

    def _expanded(self, states: Array) -> Array:
        """(K, m) corners of the motions through states, with the start's own winding."""
        corners = [self.checker.scenario.start]
        for target in states[1:]:
            corners.extend(self.checker.space.corners(corners[-1], target, self.checker.style)[1:])
        return np.array(corners)

    def _sample(self, began: float) -> None:
        """The scenario's planner; simultaneous motions where nothing else led to a path."""
        style: MotionStyle = self.checker.style
        for attempt in range(ATTEMPTS):
            now = time.monotonic()
            until = began + self.budget if attempt == 0 else now + self.budget / 2
            if self.interrupted.is_set() or (self.best and now >= until) or now - began > LATEST * self.budget:
                break
            share = 1.0 if style == self.checker.style else FALLBACK_SHARE
            checker = (
                self.checker
                if style == self.checker.style
                else MotionChecker(self.checker.scenario, style, self.checker.bound_field)
            )
            problem = _Problem(checker, self.goals, self.seed + 1000 * attempt)
            until = now + share * max(until - now, LEAST_SHARE * self.budget)
            if not self._search(problem, now, until, only_first=self.best is None):
                if self.best or style == "simultaneous":
                    break
                style = "simultaneous"
                continue
            if self.best is None:
                failed = self._certified(checker, problem.corners())
                if failed:
                    problem.forbid(failed)
                    continue
                self._search(problem, now, until, only_first=False)
            if self._improves(problem):
                self._certified(checker, problem.corners())
            break

    def _improves(self, problem: _Problem) -> bool:
        """Whether the problem's path may be better than the best certified one."""
        return self.best is None or problem.cost_mm() < self.best.certificate.cost_mm

    def _stopper(self, began: float, until: float) -> Callable[[], bool]:
        def stop() -> bool:
            now = time.monotonic()
            best = self.best.certificate.cost_mm if self.best else None
            self.report(Progress("search", min(1.0, (now - began) / self.budget), best))
            return now >= until or self.interrupted.is_set()

        return stop

    def _search(self, problem: _Problem, began: float, until: float, *, only_first: bool) -> bool:
        """Runs or continues the search; whether there is a path."""

        def stop() -> bool:
            now, cost = time.monotonic(), problem.best_cost()
            share = min(1.0, (now - began) / max(until - began, 1e-9))
            self.report(Progress("search", share, cost if np.isfinite(cost) else None))
            return now >= until or self.interrupted.is_set() or (only_first and bool(np.isfinite(cost)))

        if problem.improves or only_first:
            problem.planner.solve(ob.PlannerTerminationCondition(stop))
        return bool(problem.definition.hasExactSolution())

    def _certified(self, checker: MotionChecker, corners: Array) -> str:
        """Reorders and certifies a path (K, m), keeps it if it is the best; why it failed, empty if it did not."""
        found_s = time.monotonic() - self.began
        result = least_error(checker, corners)
        if self.best and np.array_equal(result.after, self.best.result.after):
            return ""
        certificate = certify(
            checker.scenario, result.after, progress=lambda f: self.report(Progress("certificate", f, None))
        )
        if not certificate.valid:
            self.failure = certificate.problems[0]
            return self.failure
        candidate = _Candidate(result, certificate, found_s, time.monotonic() - self.began)
        self.first = self.first or candidate
        if self.best is None or certificate.cost_mm < self.best.certificate.cost_mm:
            self.best = candidate
        return ""


class _Problem:
    """Everything OMPL needs for one search, kept alive together and released together."""

    def __init__(self, checker: MotionChecker, goals: list[GoalState], seed: int) -> None:
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
        self.goal = ob.GoalStates(self.information)
        for goal in goals:
            self.goal.addState(self._state(goal.joints))
        self.definition.setGoal(self.goal)
        targets = [self.read(self._state(goal.joints)) for goal in goals]
        self.objective = BoundObjective(self.information, checker.scenario, goals=targets, checker=checker)
        self.definition.setOptimizationObjective(self.objective)
        self.planner: Any = PLANNERS[checker.scenario.planner.name](self.information)
        if hasattr(self.planner, "setRange"):
            self.planner.setRange(RANGE_MM.get(checker.scenario.planner.name, self.space.getMaximumExtent()))
        if hasattr(self.planner, "setGoalBias"):
            self.planner.setGoalBias(GOAL_BIAS)
        self.planner.setProblemDefinition(self.definition)
        self.planner.setup()

    @property
    def improves(self) -> bool:
        """Whether the planner goes on improving after its first path."""
        return hasattr(self.planner, "bestCost")

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
