"""Local improvement of a path that was found: its corners and its goal state go where the whole cost is lower.

A path of legs is a sequence of values for the rotations and one for the translations, each held until the next leg of
its kind: the levels. Length and error at the goal have exact derivatives by the levels; the error along the way and the
clearance are known where a path was walked. So steps go down those derivatives and at random by turns, and a step is
taken where the walked path is valid and costs less.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import ROOM_NS
from ctrplan.drive.legs import merge_legs
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import (
    FIRST_MM,
    LEAST_MM,
    LONGER,
    RANK,
    SHORTER,
    TIP_STEPS,
    goal_state,
)
from ctrplan.planning.reach import bound_slopes
from ctrplan.scenario.tip_solver import TipSolver, TipTarget, tip_target

LEAST_GAIN_MM = 1e-3  # of the cost: below, two paths are alike


@dataclass(frozen=True, eq=False)
class Level:
    """Corners from `first` to `last` - 1, at which some joints stand still; of the last ones they are the goal's."""

    joints: NDArray[np.bool_]  # (m,) that belong to the level
    first: int
    last: int


class Polish:
    """A path (K, m) that gets cheaper as long as `run` runs; `corners` and `cost_mm` are the best so far."""

    def __init__(self, checker: MotionChecker, corners: Array, seed: int, *, moves_goal: bool = True) -> None:
        """The cost is infinite where the checker refuses the path: then the first valid one is an improvement."""
        self.checker, self.space, self.moves_goal = checker, checker.space, moves_goal
        self.solver = TipSolver(checker.space, checker.mechanics, checker.watch)
        self.corners, self.cost_mm = merge_legs(corners), np.inf
        self.cost_mm = self._cost_mm(self.corners)
        self._rng = np.random.default_rng(seed)
        self._work = self._steps()

    def run(self, is_over: Callable[[], bool]) -> None:
        """Goes on, a step a time, until none is worth while or it is over."""
        for _ in self._work:
            if is_over():
                return

    def run_round(self, is_over: Callable[[], bool]) -> None:
        """Goes on until every level was moved downhill once, or it is over: what the path is worth can be told then."""
        for is_round in self._work:
            if is_round or is_over():
                return

    def _steps(self) -> Iterator[bool]:
        """Levels left out and legs divided, then steps of all levels together and of each; yields before each of these
        whether it was a round.
        """
        yield from self._leave_out()
        yield from self._divide()
        levels = self._levels()
        step_mm, at_random = np.full(len(levels) + 1, FIRST_MM), False
        while len(levels) and (step_mm > LEAST_MM).any():
            down = self._downhill(levels)
            for k in np.flatnonzero(step_mm > LEAST_MM).tolist():
                yield False
                chosen = range(len(levels)) if k == len(levels) else range(k, k + 1)
                way = self._random(levels, down) if at_random else down
                moved = self._moved(levels, [way[i] * step_mm[k] if i in chosen else None for i in range(len(levels))])
                if moved is not None and self._takes(moved):
                    step_mm[k] *= LONGER
                    down = self._downhill(levels) if chosen[-1] == len(levels) - 1 else down
                elif at_random:
                    step_mm[k] *= SHORTER
            yield True
            if len(merge_legs(self.corners)) < len(self.corners):
                self.corners = merge_legs(self.corners)
                levels = self._levels()
                step_mm = np.full(len(levels) + 1, FIRST_MM)
            at_random = not at_random

    def _cost_mm(self, corners: Array) -> float:
        if self.checker.refusal(self._new_legs(corners)):
            return np.inf
        motion = self.checker.along(corners, remembers=True)
        return self.checker.cost_mm(motion, ends_at_goal=True) if motion.valid else np.inf

    def _new_legs(self, corners: Array) -> Array:
        """The polyline (L, m) of a path's legs without those that begin or end the best path so far."""
        least = min(len(corners), len(self.corners))
        first = int((corners[:least] == self.corners[:least]).all(axis=1).cumprod().sum())
        last = int((corners[-least:] == self.corners[-least:]).all(axis=1)[::-1].cumprod().sum())
        return corners[max(0, first - 1) : max(first, len(corners) - last) + 1]

    def _takes(self, corners: Array) -> bool:
        """Whether a path is valid and costs less; then it is the path."""
        cost_mm = self._cost_mm(corners)
        if cost_mm >= self.cost_mm - LEAST_GAIN_MM:
            return False
        self.corners, self.cost_mm = corners, cost_mm
        return True

    def _levels(self) -> list[Level]:
        """Levels that may move, in order; those of the goal come last and are one."""
        levels, ends, count = list[Level](), np.zeros(self.corners.shape[1], dtype=bool), len(self.corners)
        begins = count
        for kind in (self.space.drive.is_rotation, ~self.space.drive.is_rotation):
            changes = 1 + np.flatnonzero(np.any(np.diff(self.corners[:, kind], axis=0) != 0, axis=1))
            if len(changes):
                levels += [Level(kind, a, b) for a, b in zip(changes[:-1].tolist(), changes[1:].tolist(), strict=True)]
                ends, begins = ends | kind, min(begins, int(changes[-1]))
        has_spare = int(ends.sum()) > 3  # joints: three of them hold the tip
        if has_spare and self.moves_goal and self.checker.scenario.goal.joints is None:
            levels.append(Level(ends, begins, count))
        return levels

    def _leave_out(self) -> Iterator[bool]:
        """Leaves out every level that the path does not need: a leg less, and its way."""
        k = 0
        while k < len(levels := [level for level in self._levels() if level.last < len(self.corners)]):
            for beside in (levels[k].first - 1, levels[k].last):
                yield False
                corners = self.corners.copy()
                corners[levels[k].first : levels[k].last, levels[k].joints] = corners[beside, levels[k].joints]
                if self._takes(merge_legs(corners)):
                    break
            else:
                k += 1

    def _divide(self) -> Iterator[bool]:
        """Lets half of the last leg but one follow the last, and half of the second precede the first, where that pays.

        That is a level more at either end; between them there is one behind every leg.
        """
        for first, is_end in ((len(self.corners) - 3, True), (0, False)) if len(self.corners) > 2 else ():
            yield False
            a, b, c = self.corners[first : first + 3]
            moves = a != b if is_end else b != c  # the joints whose motion is divided
            between = np.array([a, c] if is_end else [a, b])
            between[:, moves] = ((a + b if is_end else b + c) / 2)[moves]
            self._takes(merge_legs(np.concatenate([self.corners[: first + 1], between, self.corners[first + 2 :]])))

    def _downhill(self, levels: list[Level]) -> list[Array]:
        """For each level the motion (m,) by which the cost falls fastest, 1 mm long; zero where it can't fall."""
        results = []
        for level in levels:
            uphill = sum(self._pull(kind, level) for kind in self._kinds(level))
            if level.last == len(self.corners):
                uphill = self._across_the_goal(uphill + self._goal_error(level), level)
            results.append(self._unit(-np.asarray(uphill)))
        return results

    def _kinds(self, level: Level) -> Iterator[NDArray[np.bool_]]:
        rotation = self.space.drive.is_rotation
        return (kind for kind in (rotation, ~rotation) if (kind & level.joints).any())

    def _pull(self, kind: NDArray[np.bool_], level: Level) -> Array:
        """(m,) derivative of the length by a level's joints of one kind, all weighted to mm."""
        weights = np.where(kind & level.joints, self.space.weights_mm, 0.0)
        last = level.last == len(self.corners)
        first = self._begin(kind) if last else level.first
        before = self._unit_weighted((self.corners[first] - self.corners[first - 1]) * weights)
        after = 0.0 if last else self._unit_weighted((self.corners[level.last] - self.corners[first]) * weights)
        pull: Array = self.checker.scenario.cost.path * (before - after)
        return pull

    def _begin(self, kind: NDArray[np.bool_]) -> int:
        """The corner at which joints of a kind reach the goal's values."""
        return 1 + int(np.flatnonzero(np.any(np.diff(self.corners[:, kind], axis=0) != 0, axis=1))[-1])

    def _goal_error(self, level: Level) -> Array:
        """(m,) derivative of what the worst case at the goal costs, weighted."""
        weight = self.checker.scenario.cost.error_goal * MM_PER_M
        slopes = bound_slopes(self.checker, self.corners[-1:])
        self._slopes = slopes
        by: Array = weight * np.where(level.joints, slopes.bound_by[0], 0.0) / self.space.weights_mm
        return by

    def _across_the_goal(self, motion: Array, level: Level) -> Array:
        """What of a weighted motion (m,) of the goal's joints leaves the tip where it is, to first order."""
        by = np.where(level.joints, self._slopes.tip_by[0], 0.0) / self.space.weights_mm
        across: Array = motion - np.linalg.pinv(by, RANK) @ (by @ motion)
        return np.where(level.joints, across, 0.0)

    def _random(self, levels: list[Level], down: list[Array]) -> list[Array]:
        """Motions (m,) like `down` in random directions."""
        results = []
        for level in levels:
            motion = np.where(level.joints, self._rng.normal(size=len(down[0])), 0.0)
            results.append(
                self._unit(self._across_the_goal(motion, level) if level.last == len(self.corners) else motion)
            )
        return results

    def _moved(self, levels: list[Level], motions: list[Array | None]) -> Array | None:
        """The path with levels moved; None where the tip cannot be brought back, or limits forbid it."""
        corners = self.corners.copy()
        for level, motion in zip(levels, motions, strict=True):
            if motion is None or not motion.any():
                continue
            values = corners[level.last - 1] + motion
            if level.last == len(corners):
                back = self._brought_back(values)
                if back is None:
                    return None
                values = back
                for kind in self._kinds(level):
                    corners[self._begin(kind) :, kind] = values[kind]
            else:
                corners[level.first : level.last, level.joints] = values[level.joints]
        same = np.array_equal(corners, self.corners)
        return None if same or not self.space.allowed(corners) else corners

    def _brought_back(self, q: Array) -> Array | None:
        """Joint values (m,) near q with the tip on the target, of as little error; None where there are none."""
        end, target = self.corners[-1], tip_target(self.checker.scenario)
        aim = self.solver.tips(end[None])[0] + target.tip_m - self._slopes.tip_m
        if not np.isfinite(aim).all():
            return None
        start = self.space.projected(q[None], fallback=end[None])
        back = self.solver.solve(TipTarget(aim), start, TIP_STEPS, turned=False).joints[0]
        self.checker.meter.add(ROOM_NS * TIP_STEPS)
        return back if np.isfinite(goal_state(self.checker, back).bound_m) else None

    def _unit(self, weighted: Array) -> Array:
        """(m,) rad or m, 1 mm long."""
        return self._unit_weighted(weighted) / self.space.weights_mm

    @staticmethod
    def _unit_weighted(weighted: Array) -> Array:
        size = float(np.linalg.norm(weighted))
        unit: Array = weighted / size if size > 0 else weighted
        return unit
