"""The search: OMPL planners over L-shaped motions with the friction bound in their cost; reorder, certify, play."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arguments import EVENT, PROGRESS, SEARCH_TIME, SEED, Flag, Made, checked, rows_of
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Laps, SearchClock, SearchEnd, WorkMeter, interrupt_event, part_of
from ctrplan.base.long_work import Progress as FractionReport
from ctrplan.certificate.certificate import Certificate, joined_certificates
from ctrplan.certificate.certify import GoalTest, certify, frictionless_arrives, with_restart
from ctrplan.certificate.closest import failure_with_place
from ctrplan.certificate.friction_cube import refuse_many_tubes
from ctrplan.certificate.narrow_samples import remembered_looks
from ctrplan.certificate.other_equilibria import other_start, unwinding
from ctrplan.certificate.problems import with_shares
from ctrplan.certificate.uneven_friction import NEAR_LIMIT_M
from ctrplan.certificate.walked_legs import WalkedLegs, miscounted, walk_legs
from ctrplan.drive.legs import merge_legs
from ctrplan.errors import NoAnswerError
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.compensate import compensate, shifted_start
from ctrplan.planning.endings import Settled, erase, settle, settled_again
from ctrplan.planning.goal_states import (
    follow_line,
    goal_states,
    is_at_goal,
    line_beginnings,
    nearest_turn,
    shape_notes,
    turn_notes,
)
from ctrplan.planning.reordering import Reordered, as_given, assemble
from ctrplan.planning.room import refuse_blocked_fixtures, refuse_impossible_margins, start_room, start_trouble
from ctrplan.planning.search.stage_search import Answer, Candidate, Progress, Report, StageSearch
from ctrplan.plans.plan import ENDED_BY_TIME, Plan
from ctrplan.plans.planned_motion import Compensation
from ctrplan.plans.uncertainty import stated_uncertainty
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.scenario.prediction import FrictionStart
from ctrplan.scenario.scenario import CostTerm
from ctrplan.scenario.start_branch import led_on, standing
from ctrplan.scenario.tip_solver import GoalState

if TYPE_CHECKING:
    from ctrplan.certificate.arrival import Arrival
    from ctrplan.certificate.certificate import CertificateSamples
    from ctrplan.robot.observer import ObserverState
    from ctrplan.scenario.prediction import PathPrediction
    from ctrplan.scenario.scenario import Scenario


@checked(
    scenario=Made("Scenario"),
    seed=SEED,
    time_s=SEARCH_TIME,
    progress=PROGRESS,
    interrupted=EVENT,
    compensated=Flag(),
    start_state=Made("ObserverState"),
)
def plan(
    scenario: Scenario,
    *,
    seed: int = 0,
    time_s: float | None = None,
    progress: Report | None = None,
    interrupted: threading.Event | None = None,
    compensated: bool = True,
    start_state: ObserverState | None = None,
    terms: Sequence[CostTerm] = (),
) -> Plan:
    """A certified plan from the scenario's start to its goal.

    With the scenario's planner.settle = "auto" the plan ends so that every pair of tubes slips, where that is worth its
    price; with "oscillate" it ends with an oscillation that releases friction. `compensated` moves the joints at its
    end so that the tip with friction arrives, not the frictionless one; a goal in joint values is driven to as it is.
    With a `start_state` of `Robot.observer` predictions start from what was observed; bounds and clearances stay those
    of every friction state. `terms` of your own are added to the cost of every motion that is searched, reordered or
    compared, and of endings; corrections at the goal are chosen without them.

    The first path found is certified at once, better ones are sought until `time_s` is up. Without it, the search ends
    after the work that takes about the scenario's planner.time_s, and the same seed gives the same plan anywhere.
    Ctrl-C, or setting `interrupted`, ends the search early and keeps the best. Raises NoAnswerError when start or goal
    are invalid or no path was found in time, KeyboardInterrupt when it was interrupted before there was a path.
    """
    if start_state is not None:
        scenario = scenario.observed(start_state)
    scenario = standing(replace(scenario, terms=(*scenario.terms, *rows_of("terms", terms, CostTerm))))
    began, laps, report = time.monotonic(), Laps(), progress or (lambda _: None)
    budget = float(scenario.planner.time_s if time_s is None else time_s)
    refuse_many_tubes(scenario.robot)
    refuse_impossible_margins(scenario)
    refuse_blocked_fixtures(scenario)
    checker = MotionChecker(scenario, reserve_m=0.0)
    start, samples = checker.probe(scenario.start)
    if not start.valid:
        least_m = np.nan if samples is None else float(samples.clearance_m[-1])
        reason = start_trouble(checker) or with_shares(checker, scenario.start, start.reason, least_m)
        raise NoAnswerError(f"{scenario.path or scenario.name}: start: the start state is not valid: {reason}.")
    friction_law(scenario.robot)  # calibrated before the search's time begins, if it is not known yet
    laps.end("preparation")
    with interrupt_event(interrupted) as interrupted, ThreadPoolExecutor(1) as beside, remembered_looks():
        approaches = cache(partial(beside.submit, other_start, scenario, scenario.start))
        request = _PlanRequest(
            seed, began, budget, budget, time_s is not None, report, interrupted, approaches, compensated
        )
        try:
            first, stages, ended_by = _anytime_stages(scenario, request)
        except NoAnswerError as error:
            if way := unwinding(scenario):
                raise NoAnswerError(f"{error} The robot is wound up at its start; {way}.") from None
            raise
        spent_ns = [meter.spent_ns for meter in request.meters]  # corrections at the end are no search
        laps.end("search")
        finish, stages = _cheapest_as_driven(scenario, stages, compensated, report)
        laps.end("ending and compensation")
    notes: tuple[str, ...] = (*scenario.warnings, *((ENDED_BY_TIME,) if ended_by == "time" else ()))
    paths = [stage.best.result for stage in stages]
    notes += turn_notes(scenario, [path.after[-1] for path in paths])
    if any(path.on_line for path in paths):
        notes += ("Along the line, joints move simultaneously.",)
    if any(path.style == "simultaneous" and not path.on_line for path in paths):
        notes += ("No path of rotations before translations was found in time; joints move simultaneously.",)
    if lost := miscounted(scenario, finish.ways[-1][-1], finish.certificate.samples.tip_m[-1]):
        raise NoAnswerError(f"{scenario.path or scenario.name}: {lost}.")
    scenario = standing(scenario, np.concatenate(finish.ways))
    finished = assemble(
        scenario,
        paths,
        finish.certificate,
        planner=scenario.planner.name,
        seed=seed,
        clock_s=0.0,
        work_s=1e-9 * sum(spent_ns),
        first_found_s=first.found_s,
        first_certified_s=first.certified_s,
        notes=(*notes, *finish.notes, *shape_notes(scenario, [way[-1] for way in finish.ways])),
        ends=finish.ways,
        compensation=finish.compensation,
        ended_by="interruption" if interrupted.is_set() else ended_by,
    )
    laps.end("other orders and timing")
    finished = replace(finished, uncertainty=stated_uncertainty(finished), interrupted=interrupted.is_set())
    laps.end("uncertainty")
    return replace(finished, clock_s=sum(laps.seconds.values()), clock_s_by=laps.seconds)


@dataclass(frozen=True, eq=False)
class _PlanRequest:
    """What planning was asked for beside the scenario."""

    seed: int
    began: float
    budget: float  # s, real ones if `timed`, else counted: what is left of `whole`
    whole: float
    timed: bool
    report: Report
    interrupted: threading.Event
    approaches: Callable[[], Future[str]]  # to the start, begun when first asked for
    compensated: bool = True
    before: float = 0.0  # s, of `whole`, spent on other searches
    meters: list[WorkMeter] = field(default_factory=list)  # of all searches

    def refuse_other_start(self, scenario: Scenario) -> None:
        """Raises NoAnswerError where an approach to the start ends at another equilibrium."""
        if other := self.approaches().result():
            raise NoAnswerError(f"{scenario.path or scenario.name}: start: {other[0].lower()}{other[1:]}.")


Stages = list[Answer]


def _anytime_stages(scenario: Scenario, request: _PlanRequest) -> tuple[Candidate, Stages, SearchEnd]:
    """The candidate that first completed the way to all targets, the way to be driven, and what ended the search.

    Of several targets the way to all is completed with the first path to each before any is improved, in what that left
    of the budget.
    """
    if not scenario.via:
        stages, ended_by, _ = _stages(scenario, request, StageSearch.run)
        return stages[-1].first, stages, ended_by
    hasty, _, spent = _stages(scenario, request, StageSearch.run_to_first)
    ran_out: SearchEnd = "time" if request.timed else "count"
    if spent >= request.budget:
        return hasty[-1].first, hasty, ran_out
    try:
        stages, ended_by, _ = _stages(
            scenario, replace(request, budget=request.budget - spent, before=spent), StageSearch.run
        )
    except (KeyboardInterrupt, NoAnswerError):
        return hasty[-1].first, hasty, ran_out
    kept = min(stages, hasty, key=lambda way: sum(stage.best.cost_mm for stage in way))
    return hasty[-1].first, kept, ended_by


def _stages(
    scenario: Scenario, request: _PlanRequest, run: Callable[[StageSearch], Answer]
) -> tuple[Stages, SearchEnd, float]:
    """The first and the best certified path to each target, from where the one before ended; what ended it; its time.

    Time [s] is the searches' own, as their clocks count it.
    """
    stages: Stages = []
    ended_by: SearchEnd = "completion"
    spent = 0.0
    start, targets, refuse_start = scenario.start, scenario.targets, partial(request.refuse_other_start, scenario)
    share = request.budget / max(1, sum(goal.line_m is None for goal in targets))  # lines to follow take none
    for k, goal in enumerate(targets):
        stage = replace(scenario.stage_from(start), goal=nearest_turn(scenario, start, goal))
        checker = MotionChecker(stage)
        request.meters.append(checker.meter)
        if goal.line_m is not None:
            refuse_start()
            stages.append(_along_line(checker, request.began))
        elif is_at_goal(stage):
            refuse_start()
            goal_states(checker, np.random.default_rng(request.seed + k))  # refuses a state that is not allowed
            stages.append(_without_motion(checker, request.began))
        else:
            try:
                checker, goals = _with_goals(checker, request.seed + k)
            except NoAnswerError:
                refuse_start()  # what is wrong with the start is said before what is with the goal
                raise
            request.approaches()  # simulated while a first path is sought, which leaves some of the machine idle
            begins_line = k + 1 < len(targets) and targets[k + 1].line_m is not None
            if begins_line:
                goals = line_beginnings(checker, goals, targets[k + 1])
            clock = SearchClock(checker.meter, request.timed, share)
            search = StageSearch(
                checker, goals, request.seed, request.began, share, clock, request.report, request.interrupted
            )
            search.refuse_start, search.moves_goal = refuse_start, not begins_line
            search.is_compensated = request.compensated
            search.is_all_moved = request.compensated and not stages and stage.planner.settle != "oscillate"
            search.before, search.whole = request.before + spent, request.whole
            stages.append(run(search))
            spent += clock.now()
            ended_by = clock.name if clock.ran_out else ended_by
        corners = stages[-1].best.corners
        start, scenario = corners[-1], led_on(scenario, corners)
    return stages, ended_by, spent


def _with_goals(checker: MotionChecker, seed: int) -> tuple[MotionChecker, list[GoalState]]:
    """Goal states, and the checker with the reserve that the start and they leave; NoAnswerError without any."""
    start = start_room(checker)
    with suppress(NoAnswerError):
        if start >= checker.reserve_m:
            return checker, goal_states(checker, np.random.default_rng(seed))
    bare = checker.without_reserve()
    goals = goal_states(bare, np.random.default_rng(seed))
    return bare, goals


def _along_line(checker: MotionChecker, began: float) -> Answer:
    """The line's own path, certified. Raises NoAnswerError where it fails."""
    scenario = checker.scenario
    corners, failed = follow_line(checker, scenario.start, scenario.goal)
    corners = merge_legs(corners)
    found_s = time.monotonic() - began
    walk = None if failed else walk_legs(scenario, corners)
    if walk is None or walk.failure:
        why = failed or (failure_with_place(walk) if walk else "")
        key = f"{scenario.goal.table}.line_mm"
        raise NoAnswerError(f"{scenario.path or scenario.name}: {key}: {why.rstrip('.')}.")
    motion = checker.along(corners)
    result = Reordered(corners, corners, motion, motion, "simultaneous", on_line=True)
    return _first_certified(checker, result, walk, found_s, began, "line")


def _without_motion(checker: MotionChecker, began: float) -> Answer:
    """The start itself, certified, where it is the goal: nothing is searched. Raises NoAnswerError where it fails."""
    scenario, corners = checker.scenario, checker.scenario.start[None]
    found_s = time.monotonic() - began
    walk = walk_legs(scenario, corners)
    if walk.failure:
        where = f"{scenario.path or scenario.name}: {scenario.goal.table}"
        raise NoAnswerError(f"{where}: is the start, which fails: {failure_with_place(walk)}")
    return _first_certified(checker, as_given(checker, corners), walk, found_s, began, "start")


def _first_certified(
    checker: MotionChecker, result: Reordered, walk: WalkedLegs, found_s: float, began: float, found_by: str
) -> Answer:
    """A certified way that no search was needed for, as the first and the best."""
    candidate = Candidate(checker, result.after, walk, found_s, time.monotonic() - began, found_by, result)
    return Answer(candidate, candidate)


@dataclass(frozen=True, eq=False)
class _Finish:
    """What becomes of the ways to the targets after the search."""

    ways: list[Array]  # (K, m) of each stage
    certificate: Certificate  # of all
    compensation: Compensation | None  # of the last one
    notes: tuple[str, ...]


def _cheapest_as_driven(
    scenario: Scenario, stages: Stages, compensated: bool, report: Report
) -> tuple[_Finish, Stages]:
    """The ways to the targets with their ends, of all candidates for the last the cheapest as it arrives.

    Where compensation leaves an offset, that costs as much as an error at the goal: another candidate may cost less.
    """
    result, kept = _finish(scenario, stages, compensated, report), stages
    offset_mm = _offset_cost_mm(scenario, result)
    for candidate in stages[-1].dearer if compensated else ():
        if candidate.cost_mm >= kept[-1].best.cost_mm + offset_mm:
            break
        if not candidate.certificate.valid:
            continue
        others = [*stages[:-1], stages[-1]._replace(best=candidate)]
        try:
            other = _finish(scenario, others, compensated, report)
        except NoAnswerError:  # what is asked for all its clearance fails; the best does not
            continue
        if candidate.cost_mm + _offset_cost_mm(scenario, other) < kept[-1].best.cost_mm + offset_mm:
            result, kept, offset_mm = other, others, _offset_cost_mm(scenario, other)
    return result, kept


def _offset_cost_mm(scenario: Scenario, finish: _Finish) -> float:
    """What it costs by how much the middle of where the tip may arrive misses the last target."""
    arrival = finish.certificate.arrival
    return scenario.cost.error_goal * MM_PER_M * arrival.by_cause.offset_m if arrival else 0.0


def _finish(scenario: Scenario, stages: Stages, compensated: bool, report: Report) -> _Finish:
    """Ends the way to every target so that friction is forgotten, and compensates what is left, one after the other.

    The friction states that one stage ends with are those that the next begins with. Where a corrected stage leaves no
    valid way on, nothing is corrected.
    """
    last, certificates = stages[-1].best, list[Certificate]()
    cost_mm = sum(stage.best.cost_mm for stage in stages)
    report(Progress("search", 1.0, cost_mm))
    done = 0.0

    def tell(fraction: float) -> None:
        nonlocal done
        done = max(done, fraction)  # several certificates may follow, which none before them knows
        report(Progress("certificate", done, cost_mm))

    shift = np.zeros_like(last.corners[0])
    ways, notes, compensation = list[Array](), list[str](), None
    for k, (_, best, _) in enumerate(stages):
        reporter = part_of(tell, k, len(stages))
        stage, corners, is_moved = best.checker.scenario, best.result.after, bool(shift.any())
        starts: list[FrictionStart] | None = list(certificates[-1].end_states) or None if certificates else None
        goal_test: GoalTest = any_end if is_moved else frictionless_arrives
        if is_moved:
            is_rotation = best.checker.space.drive.is_rotation
            corners = shifted_start(corners, is_rotation, shift, keeps_end=stage.goal.tip_m is None)
            stage = replace(led_on(stage, np.array([stage.start, corners[0]])), start=corners[0])
        if is_moved or starts:
            certificate = certify(
                stage, corners, goal_test=goal_test, starts=starts, restart=False, spare_m=NEAR_LIMIT_M
            )
        else:
            certificate = best.certificate
        checker = MotionChecker(stage)
        ended = _ended(checker, corners, certificate, starts, goal_test, reporter)
        notes += [ended.note] if ended.note else []
        corners, certificate, change = ended.corners, ended.certificate, None
        if compensated and stage.goal.tip_m is not None and stage.goal.joints is None:
            driven = best.driven if corners is best.result.after else None
            result = compensate(checker, corners, certificate, driven, starts=starts, progress=reporter)
            corners, certificate, change = result.corners, result.certificate, result.compensation
        if np.isfinite(certificate.spare_m):  # nothing was corrected: what is driven is asked for all its clearance
            settling = certificate.settling
            certificate = certify(stage, corners, goal_test=goal_test, starts=starts, restart=False, progress=reporter)
            certificate = replace(certificate, settling=settling and settled_again(settling, certificate, 0))
            if not (certificate.valid or compensated or starts or is_moved):
                name = scenario.path or scenario.name
                raise NoAnswerError(f"{name}: no path in time passed its certificate: {certificate.problems[0]}")
        if compensated and (not certificate.valid or is_moved and not _arrives(stage, certificate)):
            return replace(
                _finish(scenario, stages, False, report),
                notes=("The motions to the targets are not compensated: no corrected one leads on to the next.",),
            )
        ways.append(corners)
        certificates.append(with_restart(standing(stage, corners), certificate, starts))
        compensation = _with_steps(change, certificates[-1])
        shift = corners[-1] - best.result.after[-1]
    return _Finish(ways, joined_certificates(certificates), compensation, tuple(notes))


def _with_steps(change: Compensation | None, last: Certificate) -> Compensation | None:
    """What steps of histories add to the arrival that was certified in the end belongs to both errors."""
    if change is None or last.arrival is None:
        return change
    steps_m = last.arrival.error_m - change.error_with_m
    return replace(change, error_without_m=change.error_without_m + steps_m, error_with_m=last.arrival.error_m)


def any_end(
    scenario: Scenario, samples: CertificateSamples, prediction: PathPrediction, arrival: Arrival | None
) -> list[str]:
    """No end of a path is wrong: it is corrected yet."""
    return []


def _arrives(scenario: Scenario, certificate: Certificate) -> bool:
    """Whether a motion whose start was moved ends at its target, by its middle or without friction."""
    off_m = certificate.arrival.by_cause.offset_m if certificate.arrival else np.inf
    return scenario.goal.tip_m is None or min(off_m, certificate.goal_tip_error_m) <= scenario.goal.tolerance_m


def _ended(
    checker: MotionChecker,
    corners: Array,
    certificate: Certificate,
    starts: list[FrictionStart] | None,
    goal_test: GoalTest,
    progress: FractionReport,
) -> Settled:
    """The path with the ending that the scenario's planner.settle asks for."""
    kind = checker.scenario.planner.settle
    if kind == "none":
        return Settled(corners, certificate)
    end = settle if kind == "oscillate" else erase
    return end(checker, corners, certificate, goal_test=goal_test, starts=starts, progress=progress)
