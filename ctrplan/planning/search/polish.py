"""Local improvement of a path that was found: its corners and its goal state go where the whole cost is lower.

Steps follow a model of the path, `PathModel`, to where it costs least within what the model says of clearance, limits
and tip. A step that ends too close to the anatomy is corrected by what the model there asks for. The error along the
way has no derivative: random steps within the model's limits find what it is worth. A path is taken where its walk is
valid and it costs less. Several paths are polished by turns, as they will be driven once they are compensated.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import ROOM_NS
from ctrplan.drive.legs import merge_legs, new_legs
from ctrplan.mechanics.walk import PathSamples
from ctrplan.motion.checker import ASTRAY_M, DEFINITE_COLLISION_M, MotionChecker
from ctrplan.planning.compensate import aimed, brought_to_goal
from ctrplan.planning.goal_states import CORRECTIONS, FIRST_MM, LEAST_MM, LONGER, TIP_STEPS
from ctrplan.planning.reach import SHORTER
from ctrplan.planning.reordering import Reordered, as_given, least_error_order
from ctrplan.planning.search.path_model import NearPlaces, PathModel, levels_of, slope_along
from ctrplan.planning.search.roadmap_search import RoadmapSearch
from ctrplan.scenario.prediction import end_middle_m, frictionless_tips
from ctrplan.scenario.tip_solver import LEAST_DAMPING, TipSolver, TipTarget, angle_to, target_in_robot_frame, tip_target

LEAST_GAIN_MM = 0.05  # of the cost: a step that gains less is not worth a walk
DAMPING = 0.05  # 1/mm: of the first step, which for 20 mm adds half of what 20 mm cost
# Share of the search's reserve of clearance that a path keeps where it is driven; without any, compensation finds no
# room, and one plan of sinus ended 2.9 mm off its target
RESERVE_LEFT = 0.5
FOLLOWED_M = SHORTER * ASTRAY_M  # by which a step moves the goal after friction: as far as corrections can follow
MOST_AHEAD = 8  # steps of a model before a walk; a budget
TURNS = 4  # of a race: half of them to begin so many paths, half for the best of them; a budget


class Polish:
    """A path (K, m) that gets cheaper as long as `run` runs.

    `corners` and `cost_mm` are the best so far, `trail` all that were, with their costs, in their order.
    """

    def __init__(
        self, checker: MotionChecker, corners: Array, seed: int, *, moves_goal: bool = True, is_aimed: bool = False
    ) -> None:
        """The cost is infinite where the checker refuses the path: then the first step corrects it.

        With `is_aimed` the tip with friction is to arrive, not the frictionless one.
        """
        self.checker, self.space, self.moves_goal, self.is_aimed = checker, checker.space, moves_goal, is_aimed
        self.solver = TipSolver(checker.space, checker.mechanics, checker.watch)
        self.corners, self.cost_mm = merge_legs(corners), np.inf
        self.cost_mm = self._cost_mm(self.corners)
        self.trail = [(self.cost_mm, self.corners)] if np.isfinite(self.cost_mm) else []
        self._near, self._rng = NearPlaces(checker), np.random.default_rng(seed)
        self._stray_mm = np.zeros(0)  # lengths of random steps of each level, and of all together
        self._work = self._steps()

    def run(self, is_over: Callable[[], bool]) -> None:
        """Goes on, a step a time, until none is worth while or it is over."""
        for _ in self._work:
            if is_over():
                return

    def put_right(self) -> bool:
        """Corrects a path that comes too close; whether it is valid then."""
        return np.isfinite(self.cost_mm) or self._takes_corrected(self.corners)

    def _steps(self) -> Iterator[None]:
        """Yields before each step."""
        if not np.isfinite(self.cost_mm):
            yield
        if self.put_right():
            yield from self._leave_out()
            yield from self._divide()
        before_mm = np.inf
        while self.cost_mm < before_mm:
            before_mm = self.cost_mm
            yield from self._descend()
            yield from self._stray()

    def _descend(self) -> Iterator[None]:
        """Steps of all levels, as the model of the path has them, until it promises no more.

        A path is walked after several steps: between them, zero-clearance shapes tell the next model where it is near.
        """
        damping, most, model = DAMPING, 1, self._model()
        while model.size:
            yield
            onward, steps = model, 0
            while steps < most and (step := self._worthwhile(onward, damping)) is not None:
                ahead = self._foreseen(self._moved(onward, step), model)
                if ahead is not None and ahead.foreseen_mm(model) < onward.foreseen_mm(model):
                    onward, steps = ahead, steps + 1
                elif steps:
                    break
                else:
                    damping /= SHORTER**2
            if not steps:
                return
            if self._takes_corrected(onward.corners):
                damping, most = max(SHORTER**2 * damping, LEAST_DAMPING), min(2 * most, MOST_AHEAD)
                model = self._model()
            elif steps > 1:
                most = steps // 2
            else:
                damping /= SHORTER**2

    def _worthwhile(self, model: PathModel, damping: float) -> Array | None:
        """A model's step (X,), None where it gains too little."""
        step = model.step(damping)
        is_short = step is None or np.linalg.norm(step) < LEAST_MM or model.gain_mm(step) < LEAST_GAIN_MM
        return None if is_short else step

    def _foreseen(self, corners: Array | None, model: PathModel) -> PathModel | None:
        """The model of a path beside the best, as far as it can be foreseen, corrected where that is too close.

        None where it cannot be, or limits forbid it.
        """
        walk = self.checker.known_walk(self.corners)
        for _ in range(1 + CORRECTIONS):
            places = None if corners is None else self._near.foreseen(corners, self.corners, walk)
            if corners is None or places is None:
                return None
            ahead = PathModel(self.checker, corners, model.levels, places, model.along)
            if (ahead.room_mm >= 0).all():
                return ahead
            step = ahead.correction()
            corners = None if step is None else self._moved(ahead, step)
        return None

    def _stray(self) -> Iterator[None]:
        """Random steps of each level and of all, until one led lower or they are short."""
        model = self._model()
        count = 1 + int(model.levels.level.max(initial=-1))
        if len(self._stray_mm) != count + 1:
            self._stray_mm = np.full(count + 1, FIRST_MM)
        before_mm, step_mm = self.cost_mm, self._stray_mm
        while model.size and self.cost_mm == before_mm and (step_mm > LEAST_MM).any():
            for k in np.flatnonzero(step_mm > LEAST_MM).tolist():
                yield
                way = np.where((k == count) | (model.levels.level == k), self._rng.normal(size=model.size), 0.0)
                step = model.nearest(step_mm[k] / np.linalg.norm(way) * way)
                if self._takes(None if step is None else self._moved(model, step)):
                    step_mm[k] *= LONGER
                    model = self._model()
                    if model.levels.level.max(initial=-1) != count - 1:
                        return
                else:
                    step_mm[k] *= SHORTER

    def _leave_out(self) -> Iterator[None]:
        """Leaves out every level that the path does not need: a leg less, and its way."""
        k = 0
        while k < len(levels := levels_of(self.checker, self.corners, moves_goal=False).places()):
            first, last, joints = levels[k]
            for beside in (first - 1, last):
                yield
                corners = self.corners.copy()
                corners[first:last, joints] = corners[beside, joints]
                if self._takes(self._aimed_anew(corners)):
                    break
            else:
                k += 1

    def _divide(self) -> Iterator[None]:
        """Lets half of the last leg but one follow the last, and half of the second precede the first, where that pays.

        That is a level more at either end; between them there is one behind every leg.
        """
        for first, is_end in ((len(self.corners) - 3, True), (0, False)) if len(self.corners) > 2 else ():
            yield
            a, b, c = self.corners[first : first + 3]
            moves = a != b if is_end else b != c  # the joints whose motion is divided
            between = np.array([a, c] if is_end else [a, b])
            between[:, moves] = ((a + b if is_end else b + c) / 2)[moves]
            divided = np.concatenate([self.corners[: first + 1], between, self.corners[first + 2 :]])
            self._takes(self._aimed_anew(divided))

    def _model(self) -> PathModel:
        """The model of the best path so far."""
        return self._model_of(self.corners, self.checker.known_walk(self.corners))

    def _model_of(self, corners: Array, samples: PathSamples, before: PathModel | None = None) -> PathModel:
        """The model of a walked path, beside which places of a model before it are kept where they are expected."""
        levels = levels_of(self.checker, corners, moves_goal=self.moves_goal)
        along = slope_along(self.checker, corners, levels, samples)
        places = list(self._near.along(corners, samples))
        if before is not None:
            delta = (corners - before.corners) * self.space.weights_mm
            places += [place.moved(delta) for place in before.places]
        return PathModel(self.checker, corners, levels, places, along)

    def _aimed_anew(self, corners: Array) -> Array:
        """The path with its end where the tip with friction arrives, if friction takes it farther than steps follow."""
        if self.is_aimed and self.space.allowed(corners) and np.linalg.norm(self._miss_m(corners)) > FOLLOWED_M:
            return aimed(self.checker, corners, self.corners)[1]
        return corners

    def _takes_corrected(self, corners: Array | None) -> bool:
        """Whether a path, corrected where it comes too close, is valid and costs less; then it is the path.

        One that is dearer only for where friction takes its tip is aimed anew, and corrected there.
        """
        there = self._corrected(corners)
        if there is None or self._takes(there):
            return there is not None
        if not self.is_aimed or not self._priced_mm(there) < self.cost_mm - LEAST_GAIN_MM:
            return False
        anew = aimed(self.checker, there, self.corners)[1]
        return anew is not there and self._takes(self._corrected(anew, self._tip_m(anew)))

    def _corrected(self, corners: Array | None, aim_m: Array | None = None) -> Array | None:
        """A path (K, m) to an aim (3,) corrected where it is too close; None where that leads astray, or is refused."""
        model = None
        for correction in range(1 + CORRECTIONS):
            samples = None if corners is None else self._walked(corners)
            if corners is None or samples is None:
                return None
            short_m = self.checker.limits.clearance_m - float(samples.clearance_m.min())
            if short_m <= 0 or correction == CORRECTIONS:
                return corners
            if not short_m < ASTRAY_M:
                return None
            model = self._model_of(corners, samples, model)
            step = model.correction()
            corners = None if step is None else self._moved(model, step, aim_m)
        return None

    def _takes(self, corners: Array | None) -> bool:
        """Whether a path is valid and costs less; then it is the path."""
        if corners is None or self.checker.refusal(new_legs(corners, self.corners)):
            return False
        corners, most_mm = merge_legs(corners), self.cost_mm - LEAST_GAIN_MM
        cost_mm = self._cost_mm(corners)
        if self.is_aimed and cost_mm < most_mm:  # expected: now it is simulated from every start
            cost_mm += self._miss_cost_mm(corners, corners) - self._miss_cost_mm(corners)
        if not cost_mm < most_mm:
            return False
        self.corners, self.cost_mm = corners, cost_mm
        self.trail.append((self.cost_mm, self.corners))
        self.__dict__.pop("_aim_m", None)
        return True

    def _cost_mm(self, corners: Array) -> float:
        cost_mm = self._priced_mm(corners)
        if self.is_aimed and cost_mm < self.cost_mm:
            cost_mm += self._miss_cost_mm(corners)
        return cost_mm

    def _priced_mm(self, corners: Array) -> float:
        """What a path costs if the tip arrives; infinite where it is not valid."""
        samples = self._walked(corners)
        if samples is None or not self._arrives(samples):
            return np.inf
        motion = self.checker.judged(corners, samples)
        return self.checker.cost_mm(motion, ends_at_goal=True) if motion.valid else np.inf

    def _miss_cost_mm(self, corners: Array, beside: Array | None = None) -> float:
        """What it costs that the tip with friction misses by more than the next step makes up for.

        It is an error at the goal, and motion that makes up for it.
        """
        weights = self.checker.scenario.cost
        miss_m = float(np.linalg.norm(self._miss_m(corners, beside)))
        left_mm = max(miss_m - FOLLOWED_M, 0.0) * MM_PER_M
        return (weights.error_goal + weights.path) * left_mm if np.isfinite(miss_m) else np.inf

    def _walked(self, corners: Array) -> PathSamples | None:
        """The walk of a path; None where limits or zero-clearance shapes along new legs refuse it."""
        legs, least_m = new_legs(corners, self.corners), DEFINITE_COLLISION_M - ASTRAY_M
        is_refused = not self.space.allowed(corners) or self.checker.rooms([legs])[0] < least_m
        return None if is_refused else self.checker.known_walk(corners)

    def _arrives(self, samples: PathSamples) -> bool:
        """Whether the frictionless tip at the end of a walk is at the goal, where that is a tip.

        What an aimed one misses is a cost.
        """
        goal = self.checker.scenario.goal
        if goal.joints is not None or not self.moves_goal:
            return True
        target = tip_target(self.checker.scenario)
        off_m = 0.0 if self.is_aimed else float(np.linalg.norm(samples.tip_m[-1] - target.tip_m))
        turned_rad = float(angle_to(samples.tip_tangent[-1:], target.direction)[0])
        return off_m <= goal.tolerance_m and turned_rad <= target.direction_tolerance_rad

    def _moved(self, model: PathModel, step: Array, aim_m: Array | None = None) -> Array | None:
        """The model's path after a step (X,), the tip at its aim; None where it can't be, or limits forbid it."""
        corners = model.corners + model.levels.spread @ step / self.space.weights_mm
        if model.levels.has_goal:
            back = self._brought_back(model, corners[-1], self._aim_m if aim_m is None else aim_m)
            if back is None:
                return None
            is_goal = model.levels.level == model.levels.level[-1]
            corners = corners + model.levels.spread[:, :, is_goal].sum(axis=2) * (back - corners[-1])
        return corners if self.space.allowed(corners) else None

    def _brought_back(self, model: PathModel, q: Array, aim_m: Array) -> Array | None:
        """Joint values (m,) near q with the frictionless tip at (3,); None where they stray beyond limits."""
        end = model.corners[-1]
        aim = self.solver.tips(end[None])[0] + aim_m - model.slopes.tip_m
        if not np.isfinite(aim).all():
            return None
        start = self.space.projected(q[None], fallback=end[None])
        self.checker.meter.add(ROOM_NS * TIP_STEPS)
        return np.asarray(self.solver.solve(TipTarget(aim), start, TIP_STEPS, turned=False).joints[0])

    @cached_property
    def _aim_m(self) -> Array:
        """(3,) where the frictionless tip goes next: to the target, or nearer to where friction will take it there."""
        scenario = self.checker.scenario
        if not self.is_aimed:
            return target_in_robot_frame(scenario)
        miss_m = self._miss_m(self.corners)
        share = min(1.0, FOLLOWED_M / max(float(np.linalg.norm(miss_m)), 1e-12))
        return self._tip_m(self.corners) + share * miss_m

    def _tip_m(self, corners: Array) -> Array:
        """(3,) the frictionless tip at the end of a path (K, m)."""
        return np.asarray(frictionless_tips(self.checker.scenario.robot, corners[-1:])[0][0])

    def _miss_m(self, corners: Array, beside: Array | None = None) -> Array:
        """(3,) to the target from where the tip with friction ends on a path (K, m), by the best one or `beside`."""
        scenario = self.checker.scenario
        simulated = self.corners if beside is None else beside
        return target_in_robot_frame(scenario) - end_middle_m(scenario, corners, simulated)


class Result(NamedTuple):
    """A polished path."""

    to_goal: Array  # (K, m) with the frictionless tip at the goal
    driven: Array  # (K, m) as compensation moves it
    cost_mm: float  # of that


@dataclass(eq=False)
class Race:
    """Polishes paths of a roadmap to different goal states, each as it will be driven."""

    roadmap: RoadmapSearch
    expanded: Callable[[Array], Array]  # corners (K, m) of the motions through states
    seed: int
    is_compensated: bool  # whether paths are moved in the end, so that the tip with friction arrives
    moves_goal: bool  # whether others than the roadmap's goal states will do
    racers: list[Polish] = field(default_factory=list)

    def run(self, now: Callable[[], float], until: float, is_over: Callable[[float], bool]) -> None:
        """Polishes until then: paths to the most promising goals for a turn each, then the cheapest to its end.

        A next path is sought for no longer than a turn.
        """
        turn = (until - now()) / TURNS
        half = until - turn * TURNS / 2
        for goal in self.roadmap.promising_goals():
            known, latest = self.roadmap.known_path(goal), min(half, now() + turn)
            states = known.states if known else self.roadmap.path_to(goal, partial(is_over, latest))
            if is_over(half):
                break
            if states is not None and (racer := self._begun(self.expanded(states))):
                racer.run(partial(is_over, now() + turn))
        for racer in sorted(self.racers, key=lambda racer: racer.cost_mm):
            if not is_over(until):
                racer.run(partial(is_over, until))

    def cost_mm(self, corners: Array, unmoved_mm: float) -> float:
        """What a path (K, m) costs as it is driven.

        Where it can't be moved so that the tip arrives: unmoved_mm, and what it misses as an error at the goal.
        """
        scenario, driven = self.roadmap.checker.scenario, self._driven(self.roadmap.checker, corners)
        if driven is not None and np.isfinite(price_mm := self._price_mm(*driven)):
            return price_mm
        if not self._is_aimed:
            return unmoved_mm
        miss_m = target_in_robot_frame(scenario) - end_middle_m(scenario, corners)
        return unmoved_mm + scenario.cost.error_goal * MM_PER_M * float(np.nan_to_num(np.linalg.norm(miss_m)))

    def ordered(self, result: Result, checker: MotionChecker, corners: Array) -> Reordered:
        """The corners (K, m) of a result in the order of least error, unless they cost more then as they are driven.

        In another order friction leaves another offset, which may be out of reach.
        """
        other = least_error_order(checker, corners)
        if np.array_equal(other.after, corners) or self.cost_mm(other.after, np.inf) <= result.cost_mm:
            return other
        return as_given(checker, corners)

    def results(self) -> Iterator[Result]:
        """Polished paths as they are driven, the cheapest first, all that led to a racer's last among them.

        Where friction at the end turned round on the way, a racer's last is dearer as it is driven, or has no room.
        """
        checker = self.roadmap.checker
        least = MotionChecker(checker.scenario, checker.style, checker.meter, RESERVE_LEFT * checker.reserve_m)
        least.watch = checker.watch
        trails = (path for racer in self.racers for path in racer.trail)
        waiting: list[tuple[float, int, Array, Result | None]]
        waiting = [(cost_mm, k, corners, None) for k, (cost_mm, corners) in enumerate(trails)]
        heapq.heapify(waiting)
        while waiting:
            _, k, corners, result = heapq.heappop(waiting)
            if result is not None:
                yield result
            elif (result := self._result(least, corners)) is not None:
                heapq.heappush(waiting, (result.cost_mm, k, corners, result))

    def _result(self, least: MotionChecker, corners: Array) -> Result | None:
        """A path (K, m) as it is driven, with the reserve of `least`; None where it cannot be."""
        driven = self._driven(least, corners)
        if driven is None or not np.isfinite(price_mm := self._price_mm(*driven)):
            return None
        to_goal = corners if driven[1] is corners else brought_to_goal(self.roadmap.checker, driven[1])
        return None if to_goal is None else Result(to_goal, driven[1], price_mm)

    def _price_mm(self, checker: MotionChecker, corners: Array) -> float:
        motion = checker.along(corners)
        return checker.cost_mm(motion, ends_at_goal=True) if motion.valid else np.inf

    @property
    def _is_aimed(self) -> bool:
        goal = self.roadmap.checker.scenario.goal
        return self.is_compensated and goal.tip_m is not None and goal.joints is None and goal.line_m is None

    def _begun(self, corners: Array) -> Polish | None:
        """A racer that has yet to run, from a path (K, m) to the goal as it is driven, or as it is where that fails."""
        checker = self.roadmap.checker
        driven = self._driven(checker, corners)
        for path in () if driven is None else (driven[1], corners):
            racer = Polish(checker, path, self.seed, moves_goal=self.moves_goal, is_aimed=self._is_aimed)
            if racer.put_right():
                self.racers.append(racer)
                return racer
        return None

    def _driven(self, checker: MotionChecker, corners: Array) -> tuple[MotionChecker, Array] | None:
        """A path (K, m) as it is compensated, and a checker with its goal there; None where it can't be."""
        if not self._is_aimed:
            return checker, corners
        there, moved = aimed(checker, corners)
        return None if there is checker else (there, moved)
