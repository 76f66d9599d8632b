"""The friction bound as an OMPL objective, also for users with a set-up of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from ompl import base as ob

from ctrplan.base.arrays import Array
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.search.ompl_space import StateReader
from ctrplan.planning.search_clock import HEURISTIC_NS

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

GOAL_TOLERANCE = 1e-9  # rad or m; states at the goal are copies of goal states


class BoundObjective(ob.OptimizationObjective):  # type: ignore[misc]
    """Weighted joint length + stops + friction error along the path + error left at the goal, in mm.

    A motion that ends at one of `goals` (G, m) pays for the error left there. Motions are L-shaped, rotations before
    translations, and priced in the direction driven. States must be those of
    `ctrplan.planning.search.ompl_space.state_space`.
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

    def motionCost(self, a: Any, b: Any) -> Any:  # noqa: N802, OMPL's names from here on
        """Cost [mm] of the motion from a to b; infinite where it is not valid."""
        self.checker.watch.ask()
        start, end = self.read(a), self.read(b)
        motion = self.checker.motion(start, end)
        if not motion.valid:
            return self.infiniteCost()
        cost = self.checker.cost_mm(motion, ends_at_goal=self.is_goal(end))
        return ob.Cost(cost) if np.isfinite(cost) and cost >= 0 else self.infiniteCost()

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
        return bool(np.any(np.all(np.abs(gaps) < GOAL_TOLERANCE, axis=1)))
