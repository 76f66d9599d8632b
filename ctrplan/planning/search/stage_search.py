"""The search for a path to one target: a first one soon, certified at once; then better ones until time is up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import SearchClock, SearchOver
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import finished
from ctrplan.certificate.closest import failure_with_place
from ctrplan.certificate.uneven_friction import NEAR_LIMIT_M
from ctrplan.certificate.walked_legs import WalkedLegs, walk_legs
from ctrplan.drive.legs import merge_legs
from ctrplan.errors import NoAnswerError
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.limits import path_limits
from ctrplan.planning.compensate import on_target
from ctrplan.planning.goal_states import descended, distinct
from ctrplan.planning.reordering import Reordered, as_given, least_error_order
from ctrplan.planning.search.ompl_set_up import SearchProblem
from ctrplan.planning.search.polish import Race
from ctrplan.planning.search.proposals import direct_roadmap, retreat_roadmap
from ctrplan.planning.search.roadmap_search import RoadmapSearch
from ctrplan.scenario.tip_solver import GoalState

# Share of the time by which the roadmap's cheapest path is sought, and that polish has whenever it begins: a first path
# that took all of it is where polish gains most
PHASE_SHARE = 0.5
WORTH_A_CERTIFICATE = 5e-3  # of the cost: less gain than that is not worth a certificate, which takes longer
# Share of a time by the clock that L-shaped motions have where they lead to no path; and that of simultaneous ones,
# which a counted search has beside its budget
L_SHAPED_SHARE, FALLBACK_SHARE = 0.9, 0.18
STRAIGHT_HOPE = 0.5  # of motions from the start to a goal, without which chains are made before any is walked
FIRST_STATES, FIRST_ROUND_S = 100, 0.2  # random states a roadmap first grows by, and after how long; then twice as many
FIRST_INSERTIONS, INSERTIONS = 500, 1200  # random ones looked at each time, while there is no path and then; budgets
MOST_STATES = 3000  # of a roadmap
DOUBT_KEPT = 0.5  # from round to round, of the doubt about motions that are not checked
ATTEMPTS = 8  # searches after a path failed its certificate


@dataclass(frozen=True)
class Progress:
    """What a progress callback is told."""

    stage: str  # "search", in whose midst and after which a "certificate" or several are made
    fraction: float  # of the search to all targets by time, which never falls; of the certificate by work
    best_cost_mm: float | None  # of the best path so far


@dataclass(frozen=True, eq=False)
class Candidate:
    """A path that passed its certificate."""

    checker: MotionChecker
    corners: Array  # (K, m) as certified
    walk: WalkedLegs
    found_s: float  # since planning began
    certified_s: float
    found_by: str
    reordered: Reordered | None = None  # in order, and compared with other orders
    progress: Callable[[float], None] | None = None  # of the certificate
    driven: WalkedLegs | None = None  # as compensation may move it, where that is known and certified
    as_driven_mm: float | None = None  # the cost beside others', where it is known how compensation will change both

    @cached_property
    def result(self) -> Reordered:
        """The path reordered; else as it is, priced when it is needed: a first path is wanted soon."""
        return self.reordered or as_given(self.checker, self.corners)

    @cached_property
    def cost_mm(self) -> float:
        """The cost of a path by its certificate's samples."""
        return self.walk.cost_mm if self.as_driven_mm is None else self.as_driven_mm

    @cached_property
    def certificate(self) -> Certificate:
        """With histories simulated, and of clearance as much as the walk asked for: corrections may follow."""
        return finished(self.walk)


class Answer(NamedTuple):
    """What the search to a target leaves."""

    first: Candidate  # that was certified
    best: Candidate
    dearer: tuple[Candidate, ...] = ()  # than the best, that passed their certificates too, the cheapest first


Report = Callable[[Progress], None]
ROADMAP = "roadmap"


@dataclass(eq=False)
class StageSearch:
    """Searches, certifies and searches on, until time is up."""

    checker: MotionChecker
    goals: list[GoalState]
    seed: int
    began: float
    budget: float
    clock: SearchClock
    report: Report
    interrupted: threading.Event
    before: float = 0.0  # spent on other searches of the same plan
    whole: float | None = None  # budget of the plan, if this search has a share of it only
    refuse_start: Callable[[], None] = lambda: None  # raises where nothing that begins there may be certified
    failure: str = ""  # of the last certificate
    failed: WalkedLegs | None = None  # the last walk that failed
    first: Candidate | None = None  # that was certified
    best: Candidate | None = None
    certified: list[Candidate] = field(default_factory=list)
    moves_goal: bool = True  # whether polish may leave the goal states, for others that reach the target
    is_compensated: bool = False  # whether what is found is moved, so that the tip with friction arrives
    is_all_moved: bool = False  # whether nothing else changes it, as another start or an end that erases friction would
    has_chains: bool = False  # whether the roadmap has those that withdraw from the goals

    def run_to_first(self) -> Answer:
        """The first certified path, as the first and the best."""
        self._first_path()
        if self.best is None:
            self._without_reserve()
            self._sample(only_first=True)
        return self._answer()

    def run(self) -> Answer:
        """The first and the best certified path."""
        roadmap = self._first_path()
        if self.best is None:
            self._without_reserve()
        elif not self._is_enough():
            self._cheapest_of(roadmap)
        if self.best is not None and not self.best.reordered and not self._is_enough():
            self._tidied(self.checker, self.best.corners, self.best.found_by)
        self._sample()
        return self._answer()

    def _polish(self, roadmap: RoadmapSearch) -> bool:
        """Improves known paths to different goal states as they will be driven; the cheapest that is certified is kept.

        Whether there is one. Certificates come on top of counted work: all of them are tried until one holds as it is
        driven; compensation may correct the cheapest otherwise.
        """
        assert self.best is not None
        before, until = self.best, self.clock.now() + PHASE_SHARE * self.budget
        if self.clock.timed:
            until = min(until, self.budget)
        race = Race(roadmap, self._expanded, self.seed, self.is_compensated, self.moves_goal)
        begun_mm = before.cost_mm
        with self._ending(until):
            begun_mm = race.cost_mm(before.corners, before.cost_mm)
            race.run(self.clock.now, until, self._is_over)
        cheapest: Callable[[], str] | None = None
        for result in race.results():
            gain_mm = begun_mm - result.cost_mm
            if self._is_enough() or not gain_mm > WORTH_A_CERTIFICATE * begun_mm:
                break
            as_driven_mm = before.cost_mm - gain_mm if self.is_compensated else None
            tidied = partial(
                self._tidied, roadmap.checker, result.to_goal, ROADMAP, order=partial(race.ordered, result)
            )
            driven = result.driven if self.is_all_moved and result.driven is not result.to_goal else None
            if not tidied(as_driven_mm=as_driven_mm, driven=driven):
                return True
            if self.clock.timed and self._is_over(self.budget):
                break
            if driven is not None:
                cheapest = cheapest or partial(tidied, as_driven_mm=as_driven_mm)
        return cheapest is not None and not self._is_enough() and not cheapest()

    def _without_reserve(self) -> None:
        """No path keeps more clearance than the certificate asks for: what keeps no more is looked for."""
        if self.checker.reserve_m > 0:
            self.checker = self.checker.without_reserve()

    def _answer(self) -> Answer:
        """The first and the best that their own simulation does not contradict.

        Raises NoAnswerError or KeyboardInterrupt without one.
        """
        certified = sorted(self.certified, key=lambda candidate: candidate.cost_mm)
        for k, candidate in enumerate(certified, 1):
            self._tell()
            if candidate.certificate.valid:
                return Answer(self.first or candidate, candidate, tuple(certified[k:]))
            self.failure = candidate.certificate.problems[0]
        if self.interrupted.is_set():
            raise KeyboardInterrupt
        self.refuse_start()
        name = self.checker.scenario.path or self.checker.scenario.name
        if self.failure:
            failed = self.failed if self.failed and self.failed.failure == self.failure else None
            why = failure_with_place(failed) if failed else self.failure
            raise NoAnswerError(f"{name}: no path in time passed its certificate: {why}")
        outcome = f"no valid path to any of {len(self.goals)} goal states was found in time"
        key = "time_s (--time)" if self.clock.timed else "planner.time_s"
        raise NoAnswerError(f"{name}: {key} = {self.budget:g} s: {outcome}.")

    @cached_property
    def _rng(self) -> np.random.Generator:
        """The generator of a roadmap's random states: one for all phases, so that none draws those of another again."""
        return np.random.default_rng(self.seed)

    @property
    def _short_m(self) -> float:
        """What the last walk that failed is short of in clearance [m]; negative where it failed for another reason."""
        assert self.failed is not None
        return path_limits(self.checker.scenario).clearance_m - float(self.failed.samples.clearance_m.min())

    @property
    def _first_until(self) -> float:
        """When a first path of L-shaped motions is no longer sought, and simultaneous ones are tried."""
        return self.budget * (L_SHAPED_SHARE if self.clock.timed else 1.0)

    def _first_path(self) -> RoadmapSearch:
        """Any path, soon: straight to a goal where that looks free, or on a roadmap that grows while there is none."""
        search = RoadmapSearch(self.checker, direct_roadmap(self.checker, self.goals), self.goals)
        states, until, hope = FIRST_STATES, self.clock.now() + FIRST_ROUND_S, STRAIGHT_HOPE
        latest = self._first_until
        while self.best is None and not self._is_over(latest):
            path = None
            with self._ending(latest):
                path = search.any_path(lambda until=until: self._is_over(until), hope)  # type: ignore[misc]
            if path is None and hope > 0:
                with self._ending(latest):
                    self._add_chains(search)
                hope = 0.0
            elif path is None:
                with self._ending(latest):
                    search.grow(self._rng, states, FIRST_INSERTIONS)
                states, until = 2 * states, self.clock.now() + states / FIRST_STATES * FIRST_ROUND_S
                until = min(until, latest)
            elif failed := self._certified(self.checker, self._expanded(path), ROADMAP):
                assert self.failed is not None
                search.needs_more(path, self._short_m)
                search.forbid_at(path, self.failed.broken_mm, failed)
        return search

    def _add_chains(self, search: RoadmapSearch) -> None:
        """Adds chains that withdraw from the goals."""
        search.add_chains(retreat_roadmap(self.checker, self.goals))
        self.has_chains = True

    def _cheapest_of(self, search: RoadmapSearch) -> None:
        """Cheap paths on a roadmap that grows further, polished and certified.

        Where that fails, friction states between the corners, or the finer mesh, take more room than the search keeps:
        the cheapest is certified as it is, and another is sought that leaves as much.
        """
        until = PHASE_SHARE * self.budget
        with self._ending(until):
            self._prepare(search, until)
            self._grow_cheaper(search, until)
        if self._is_enough() or self._polish(search):
            return
        while not self._is_enough():
            cheapest = search.known_path()
            if cheapest is None or (self.best is not None and cheapest.cost_mm >= self.best.cost_mm):
                break
            failed = self._tidied(self.checker, self._expanded(cheapest.states), ROADMAP)
            if not failed or self._is_over(self.budget):
                break
            search.needs_more(cheapest.states, self._short_m)
            search.forbid(cheapest.states, failed)
            with self._ending(self.budget):
                self._grow_cheaper(search, self.budget)

    def _prepare(self, search: RoadmapSearch, until: float) -> None:
        """Adds chains and goal states of less error to a roadmap."""
        if not self.has_chains and not self._is_over(until):
            self._add_chains(search)
        if self.best is not None and self.checker.scenario.cost.error_goal > 0 and not self._is_over(until):
            self._descend(search)

    def _grow_cheaper(self, search: RoadmapSearch, until: float) -> None:
        """Seeks the cheapest path of a roadmap that grows until time is up."""
        states, doubt = FIRST_STATES, 1.0
        while not self._is_over(until) and len(search.joints) <= MOST_STATES:
            search.grow(self._rng, states, INSERTIONS)
            if search.cheap_path(lambda: self._is_over(until), doubt) is None and not self._is_over(until):
                break  # not even a way
            states, doubt = 2 * states, DOUBT_KEPT * doubt

    def _descend(self, search: RoadmapSearch) -> None:
        """Adds goal states with less error, the way down to them, and chains that withdraw from them."""
        trails = descended(self.checker, self.goals)
        if not trails:
            return
        search.add_trails(trails)
        lowest = distinct(self.checker, [trail[-1] for trail in trails])
        search.add_chains(retreat_roadmap(self.checker, lowest))
        self.goals = lowest + self.goals

    def _expanded(self, states: Array) -> Array:
        """(K, m) corners of the motions through states, with the start's own winding."""
        corners = [self.checker.scenario.start]
        for target in states[1:]:
            corners.extend(self.checker.space.corners(corners[-1], target, self.checker.style)[1:])
        return np.array(corners)

    def _sample(self, *, only_first: bool = False) -> None:
        """The scenario's planner, to its first path or to the end; simultaneous motions where no other led to any."""
        checker, name = self.checker, self.checker.scenario.planner.name
        until = self.budget if self.best else self._first_until
        if self.best and self._is_over(until):
            return
        for attempt in range(ATTEMPTS):
            problem, is_found = SearchProblem(checker, self.goals, self.seed + 1000 * attempt), False
            if not self._is_over(until):
                is_found = problem.solve(self._stopper(until), only_first=self.best is None)
            if not is_found:
                if self.best or checker is not self.checker or self.interrupted.is_set():
                    break
                checker = MotionChecker(checker.scenario, "simultaneous", checker.meter, checker.reserve_m)
                begins = self._first_until if self.clock.timed else self.clock.now()
                until = begins + FALLBACK_SHARE * self.budget
                continue
            if self.best is None:
                if failed := self._certified(checker, problem.corners(), name):
                    problem.forbid(failed)
                    continue
                if only_first:
                    break
                problem.solve(self._stopper(self.budget), only_first=False)
            if self._improves(problem) or not (self.best and self.best.reordered):
                self._tidied(checker, problem.corners(), name)
            break

    def _improves(self, problem: SearchProblem) -> bool:
        """Whether the problem's path may be better than the best certified one."""
        return self.best is None or problem.cost_mm() < self.best.cost_mm

    def _is_enough(self) -> bool:
        """Whether someone who waits for an end has a path already."""
        return self.interrupted.is_set() and self.best is not None

    @contextmanager
    def _ending(self, until: float) -> Iterator[None]:
        """Ends what the block does with the checker, wherever that is, when it is late or interrupted."""

        def late() -> bool:
            return self.interrupted.is_set() or self.clock.is_late(until)

        with suppress(SearchOver), self.checker.watch.until(late):
            yield

    def _is_over(self, until: float) -> bool:
        self._tell()
        return self.clock.is_past(until) or self.interrupted.is_set()

    def _stopper(self, until: float) -> Callable[[float], bool]:
        """Whether a search that ends then is over, told its best cost [mm]."""

        def stop(cost: float) -> bool:
            self._tell(cost)
            return self.clock.is_past(until) or self.interrupted.is_set()

        return stop

    def _tell(self, cost_mm: float = np.inf) -> None:
        """Reports how far the plan's search is, and the cost of its best path or of the one at hand."""
        best = min(cost_mm, self.best.cost_mm if self.best else np.inf)
        share = min(1.0, (self.before + self.clock.now()) / (self.whole or self.budget))
        self.report(Progress("search", share, best if np.isfinite(best) else None))

    def _certified(self, checker: MotionChecker, corners: Array, found_by: str) -> str:
        """Certifies a path (K, m) as it is and keeps it; why it failed, empty if it did not."""
        found_s, way = time.monotonic() - self.began, merge_legs(corners)
        self._tell()
        walk = self._walked(checker, way)
        self.failure = walk.failure
        if self.failure:
            self.failed = walk
            return self.failure
        self._keep(Candidate(checker, way, walk, found_s, time.monotonic() - self.began, found_by))
        return ""

    def _tidied(
        self,
        checker: MotionChecker,
        corners: Array,
        found_by: str,
        driven: Array | None = None,
        as_driven_mm: float | None = None,
        order: Callable[[MotionChecker, Array], Reordered] = least_error_order,
    ) -> str:
        """Reorders and certifies a path (K, m), keeps it if it is the best; why it failed, empty if it did not.

        `driven` (K, m) is how compensation may move it, which has to be certified too, and `as_driven_mm` what that
        costs beside others, if it stays as it is.
        """
        found_s = time.monotonic() - self.began
        result = order(checker, merge_legs(corners))
        if self.best is not None and np.array_equal(result.after, self.best.corners):
            tidied = replace(self.best, reordered=result)
            self.certified = [tidied if candidate is self.best else candidate for candidate in self.certified]
            self.best = tidied
            return ""
        self._tell()
        stays = np.array_equal(result.after, corners)
        as_driven = None
        if driven is not None and stays:
            as_driven = self._walked(checker, on_target(checker, driven), np.inf)
        if as_driven and as_driven.problems:
            self.failure, self.failed = as_driven.problems[0], as_driven
            return self.failure
        walk = self._walked(checker, result.after)
        if walk.failure:
            self.failure, self.failed = walk.failure, walk
            return self.failure
        certified_s = time.monotonic() - self.began
        candidate = Candidate(checker, result.after, walk, found_s, certified_s, found_by, result)
        if stays:
            candidate = replace(candidate, driven=as_driven, as_driven_mm=as_driven_mm)
        self._keep(candidate)
        return ""

    def _walked(self, checker: MotionChecker, corners: Array, spare_m: float = NEAR_LIMIT_M) -> WalkedLegs:
        """Paths (K, m) that follow a failed one mostly share legs with it."""
        self.refuse_start()
        scenario, progress = checker.scenario, self._certifying
        return walk_legs(scenario, corners, spare_m=spare_m, progress=progress, failed=self.failed)

    def _certifying(self, share: float) -> None:
        self.report(Progress("certificate", share, None))

    def _keep(self, candidate: Candidate) -> None:
        """Remembers a certified path if it is the first or the best."""
        self.checker.meter.add(self.checker.solved_ns * len(candidate.walk.samples.leg))
        candidate = replace(candidate, progress=self._certifying)
        self.first = self.first or candidate
        self.certified.append(candidate)
        if self.best is None or candidate.cost_mm < self.best.cost_mm:
            self.best = candidate
