"""The search of an OMPL planner over L-shaped motions: space, validity, objective and termination."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from ompl import base as ob
from ompl import util as ou

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import ASKED_NS, HEURISTIC_NS, SearchOver
from ctrplan.drive.drive import JOINT_ROUNDING
from ctrplan.errors import InputError
from ctrplan.motion.checker import MotionChecker
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.tip_solver import GoalState

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

TURNS_RAD = 4 * math.pi  # either way, of unlimited rotations whose turns lead elsewhere


def state_space(space: JointSpace) -> Any:
    """One subspace a joint: SO(2) where a turn leads to the same place, an interval otherwise; distance in mm."""
    compound, drive = ob.CompoundStateSpace(), space.drive
    for joint, wraps, weight in zip(drive.joints, drive.wraps, space.weights_mm, strict=True):
        if wraps:
            subspace: Any = ob.SO2StateSpace()
        else:
            subspace = ob.RealVectorStateSpace(1)
            bounds = ob.RealVectorBounds(1)
            bounds.setLow(max(joint.lower, -TURNS_RAD) if joint.is_unlimited else joint.lower)
            bounds.setHigh(min(joint.upper, TURNS_RAD) if joint.is_unlimited else joint.upper)
            subspace.setBounds(bounds)
        compound.addSubspace(subspace, float(weight))
    compound.lock()
    return compound


class StateReader:
    """Joint values (m,) of an OMPL state."""

    def __init__(self, space: JointSpace) -> None:
        """space: the one that `state_space` was made of."""
        self.wraps = [bool(w) for w in space.drive.wraps]

    def __call__(self, state: Any) -> Array:
        """Joint values (m,) [rad, m] of a state."""
        return np.array([state[i].value if wraps else state[i][0] for i, wraps in enumerate(self.wraps)])

    def write(self, state: Any, q: Array) -> None:
        """Puts joint values into a state; unlimited rotations are wrapped into [-pi, pi), OMPL's range."""
        for i, wraps in enumerate(self.wraps):
            if wraps:
                angle = math.remainder(float(q[i]), 2 * math.pi)
                state[i].value = -math.pi if angle >= math.pi else angle
            else:
                state[i][0] = float(q[i])


class Validity(ob.StateValidityChecker):  # type: ignore[misc]
    """Limits, nesting, stability, strain and clearance of a state."""

    def __init__(self, space_information: Any, checker: MotionChecker, read: StateReader) -> None:
        """read: of the space that the space information is about."""
        super().__init__(space_information)
        self.checker, self.read = checker, read

    def isValid(self, state: Any) -> bool:  # noqa: N802, OMPL's name
        """Whether the robot may stand there."""
        self.checker.watch.ask()
        return self.checker.state(self.read(state)).valid


class MotionValidity(ob.MotionValidator):  # type: ignore[misc]
    """The whole motion in the direction driven; OMPL's own interpolation is never asked."""

    def __init__(self, space_information: Any, checker: MotionChecker, read: StateReader) -> None:
        """read: of the space that the space information is about."""
        super().__init__(space_information)
        self.checker, self.read = checker, read

    def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802, OMPL's name
        """Whether the robot may go from a to b, rotations first; valid motions back may not be."""
        self.checker.watch.ask()
        return self.checker.motion(self.read(a), self.read(b)).valid


class BoundObjective(ob.OptimizationObjective):  # type: ignore[misc]
    """Weighted joint length + stops + friction error along the path + error left at the goal, in mm.

    A motion that ends at one of `goals` (G, m) pays for the error left there. Motions are L-shaped, rotations before
    translations, and priced in the direction driven. States must be those of
    `ctrplan.planning.search.ompl_set_up.state_space`.
    """

    def __init__(
        self,
        space_information: Any,
        scenario: Scenario,
        *,
        goals: Sequence[Array] = (),
        checker: MotionChecker | None = None,
    ) -> None:
        """checker: shared with validity checks, so that no motion is solved twice; a new one by default."""
        super().__init__(space_information)
        self.checker = checker or MotionChecker(scenario)
        self.read = StateReader(self.checker.space)
        drive, weights = self.checker.space.drive, self.checker.space.weights_mm
        self._joints = list(zip(drive.wraps.tolist(), drive.is_rotation.tolist(), weights.tolist(), strict=True))
        self.goals = np.array(goals).reshape(-1, len(scenario.robot.drive.joints))
        self.priced = dict[tuple[bytes, bytes], float]()  # costs [mm] of valid motions, by joint values at both ends

    def motionCost(self, a: Any, b: Any) -> Any:  # noqa: N802, OMPL's names from here on
        """Cost [mm] of the motion from a to b; infinite where it is not valid."""
        self.checker.watch.ask()
        start, end = self.read(a), self.read(b)
        motion = self.checker.motion(start, end)
        if not motion.valid:
            return self.infiniteCost()
        cost = self.checker.cost_mm(motion, ends_at_goal=self.is_goal(end))
        if not (np.isfinite(cost) and cost >= 0):
            return self.infiniteCost()
        self.priced[start.tobytes(), end.tobytes()] = cost
        return ob.Cost(cost)

    def motionCostHeuristic(self, a: Any, b: Any) -> Any:  # noqa: N802
        """Lower bound [mm] of that cost: length and stops are exact, errors never negative."""
        # asked for so often that numpy is too slow
        self.checker.watch.ask_cheaply()
        self.checker.meter.add(HEURISTIC_NS)
        squares = [0.0, 0.0]  # of translations and rotations
        for i, (wraps, turns, weight) in enumerate(self._joints):
            delta = b[i].value - a[i].value if wraps else b[i][0] - a[i][0]
            if wraps and abs(delta) > math.pi:
                delta -= math.copysign(2 * math.pi, delta)
            squares[turns] += (weight * delta) ** 2
        weights, legs = self.checker.scenario.cost, (squares[0] > 0) + (squares[1] > 0)
        return ob.Cost(weights.path * (math.sqrt(squares[0]) + math.sqrt(squares[1])) + weights.stop * legs)

    def stateCost(self, state: Any) -> Any:  # noqa: N802
        """Nothing: what a state costs is in the motion that ends there."""
        return ob.Cost(0.0)

    def isSymmetric(self) -> bool:  # noqa: N802
        """No: rotations come first on the way there and on the way back."""
        return False

    def is_goal(self, q: Array) -> bool:
        """Whether q (m,) is one of the goal states."""
        if not len(self.goals):
            return False
        gaps = np.array([self.checker.space.difference(goal, q) for goal in self.goals])
        return bool(np.any(np.all(np.abs(gaps) < JOINT_ROUNDING, axis=1)))


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
        start = self._state(checker.scenario.start)
        self.start = self.read(start)
        self.definition.addStartState(start)
        self.has_goal = any(checker.state(goal.joints).valid for goal in goals)
        self.goal = ob.GoalStates(self.information)
        for goal in goals:
            self.goal.addState(self._state(goal.joints))
        self.definition.setGoal(self.goal)
        targets = [self.read(self._state(goal.joints)) for goal in goals]
        self.objective = BoundObjective(self.information, checker.scenario, goals=targets, checker=checker)
        self.definition.setOptimizationObjective(self.objective)
        self.planner: Any = checker.scenario.planner.ompl_planner(self.information)
        if not isinstance(self.planner, ob.Planner):
            rule = f"must return a planner of OMPL, not {type(self.planner).__name__}"
            raise InputError(rule, key=f"planner {checker.scenario.planner.name}: ompl_planner")
        self.planner.setProblemDefinition(self.definition)
        self.planner.setup()
        self.cut_short: tuple[float, list[Array]] | None = None  # cost and states of the best path, ended by a question

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
        if (self.improves or only_first) and self.cut_short is None:
            is_cut = True
            with suppress(SearchOver), self.checker.watch.until(lambda: stop(self.best_cost())):
                self.planner.solve(ob.PlannerTerminationCondition(over))
                is_cut = False
            if is_cut:
                self.cut_short = self._cheapest_priced()
        return bool(self.cut_short[1]) if self.cut_short else bool(self.definition.hasExactSolution())

    def _cheapest_priced(self) -> tuple[float, list[Array]]:
        """Cost [mm] and states of the cheapest path of all motions that the planner asked the price of; inf, and none.

        A planner hands its own path over at the end of `solve`. One that an exception left in the midst of its work is
        not asked to go on, not even to the end: what it was changing may be half changed.
        """
        onward = dict[bytes, list[tuple[bytes, float]]]()
        for (a, b), cost_mm in self.objective.priced.items():
            onward.setdefault(a, []).append((b, cost_mm))
        ends, done, start = {goal.tobytes() for goal in self.objective.goals}, set[bytes](), self.start.tobytes()
        queue: list[tuple[float, bytes, list[bytes]]] = [(0.0, start, [start])]
        while queue:
            cost_mm, at, path = heapq.heappop(queue)
            if at in ends and len(path) > 1:
                return cost_mm, [np.frombuffer(state) for state in path]
            if at not in done:
                done.add(at)
                for to, step_mm in onward.get(at, []):
                    heapq.heappush(queue, (cost_mm + step_mm, to, [*path, to]))
        return np.inf, []

    def best_cost(self) -> float:
        """Cost [mm] of the best path so far, inf without one."""
        return float(self.planner.bestCost().value()) if self.improves else np.inf

    def cost_mm(self) -> float:
        """Cost [mm] of the path there is."""
        if self.cut_short:
            return self.cut_short[0]
        return float(self.definition.getSolutionPath().cost(self.objective).value())

    def states(self) -> list[Array]:
        """Joint values of the best path's states."""
        if self.cut_short:
            return self.cut_short[1]
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
