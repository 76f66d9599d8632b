"""`ctrplan.plan_uncertainty`: what parameters and a registration known by intervals may do to a plan.

How likely the tip misses its targets: drawn robots judged at each of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arrays import Array, numbers
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.errors import InputError
from ctrplan.motion.play import play_turn
from ctrplan.plans.planned_motion import PlannedMotion
from ctrplan.scenario.scenario import Scenario
from ctrplan.uncertainty.drawn_poses import DrawnPoses, DrivenPath, SimulatedPoses
from ctrplan.uncertainty.parameters import uncertain_parameters
from ctrplan.uncertainty.result import GoalMiss, TourMiss, TurnMiss, Uncertainty, closest_approach, intervals
from ctrplan.uncertainty.target import (
    POSITION,
    TANGENT,
    Misses,
    Stop,
    TargetPose,
    TipVector,
    WorstCase,
    end_stop,
    quantile95,
)
from ctrplan.uncertainty.tip_slopes import TipSlopes
from ctrplan.uncertainty.worst_case import (
    OFF,
    OFF_DIRECTION,
    PLAY,
    UNEXPLAINED,
    BaseBall,
    Chance,
    Draws,
    chance,
    ranked,
    ranked_turns,
    sentence,
    turn_sentence,
)

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Goal, Scenario


@dataclass(frozen=True, eq=False)
class Judged:
    """Misses of all draws and of those that were solved."""

    all: Misses
    solved: Misses

    @classmethod
    def of(cls, results: tuple[Misses, Misses], stop: Stop) -> Judged:
        """With play of the drive."""
        return cls(*(replace(m, off_m=m.off_m + stop.play_m, turned_rad=m.turned_rad + stop.play_rad) for m in results))

    def missed(self, aim: TargetPose) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Position or direction."""
        return self.all.missed(aim), self.solved.missed(aim)


@dataclass(frozen=True, eq=False)
class StopJudged:
    """What a target asks for, and how drawn robots meet it."""

    aim: TargetPose
    any_friction: Judged
    by_history: Judged | None


def judged(
    scenario: Scenario, drawn: DrawnPoses, stop: Stop, number: int, simulated: SimulatedPoses | None
) -> StopJudged:
    """The misses at a target, the `number`-th before the last: unexplained errors are those of another pose."""
    draws = drawn.draws.elsewhere(number) if number else drawn.draws
    aim = TargetPose.of(scenario, stop.goal, drawn.slopes.tip_m[stop.places[-1], 0])
    any_friction = Judged.of(drawn.any_friction(aim, stop.places, draws), stop)
    if simulated is None:
        return StopJudged(aim, any_friction, None)
    return StopJudged(aim, any_friction, Judged.of(drawn.by_history(aim, stop.places, draws, simulated), stop))


def goal_miss(scenario: Scenario, drawn: DrawnPoses, stop: Stop, result: StopJudged) -> GoalMiss:
    """The result at a target."""
    aim, history = result.aim, result.by_history
    worst, place = _worst_off(scenario, drawn, stop, aim)
    contributors = ranked(worst.given, {**worst.saved, UNEXPLAINED: scenario.robot.model_error_m})
    is_judged = aim.tolerance_m is not None
    return GoalMiss(
        worst_m=worst.size,
        contributors=contributors,
        friction_state=worst.friction_state,
        beyond_first_order_m=worst.beyond_first_order,
        tolerance_m=aim.tolerance_m,
        chance_any_friction=chance(*result.any_friction.missed(aim)) if is_judged else None,
        chance_by_history=chance(*history.missed(aim)) if history and is_judged else None,
        quantile_any_friction_m=quantile95(result.any_friction.all.off_m),
        quantile_by_history_m=quantile95(history.all.off_m) if history else None,
        sentence=sentence(worst.size, contributors),
        name=stop.goal.name,
        sample=int(stop.samples[place]),
        turn=None if aim.direction is None else _turn(scenario, drawn, stop, result),
    )


def _turn(scenario: Scenario, drawn: DrawnPoses, stop: Stop, result: StopJudged) -> TurnMiss:
    aim, history = result.aim, result.by_history
    assert aim.direction is not None and aim.direction_tolerance_rad is not None
    base = BaseBall.of(0.0, scenario.registration.rotation_sigma_rad)
    vector = _vector(drawn, int(stop.places[-1]), TANGENT, aim.direction, base)
    worst = _as_angle(vector.worst(OFF_DIRECTION, {}), stop.play_rad)
    contributors = ranked_turns(worst.given, worst.saved)
    return TurnMiss(
        worst_rad=worst.size,
        contributors=contributors,
        friction_state=worst.friction_state,
        beyond_first_order_rad=worst.beyond_first_order,
        tolerance_rad=aim.direction_tolerance_rad,
        chance_any_friction=chance(
            *(m.turned_away(aim) for m in (result.any_friction.all, result.any_friction.solved))
        ),
        chance_by_history=chance(*(m.turned_away(aim) for m in (history.all, history.solved))) if history else None,
        quantile_any_friction_rad=quantile95(result.any_friction.all.turned_rad),
        quantile_by_history_rad=quantile95(history.all.turned_rad) if history else None,
        sentence=turn_sentence(worst.size, contributors),
    )


def _worst_off(scenario: Scenario, drawn: DrawnPoses, stop: Stop, aim: TargetPose) -> tuple[WorstCase, int]:
    """The worst of a target's places, and which that is."""
    registration = scenario.registration
    base = BaseBall.of(registration.position_sigma_m, registration.rotation_sigma_rad)
    rest = {UNEXPLAINED: scenario.robot.model_error_m, PLAY: stop.play_m}
    cases = []
    for k, w in enumerate(stop.places.tolist()):
        target = aim.nearest_m(drawn.slopes.tip_m[w, 0], k == len(stop.places) - 1)
        cases.append(_vector(drawn, w, POSITION, target, base).worst(OFF, rest))
    place = int(np.argmax([case.size for case in cases]))
    return cases[place], place


def _vector(drawn: DrawnPoses, w: int, part: slice, target: Array, base: BaseBall) -> TipVector:
    row = slice(w, w + 1)
    slopes = TipSlopes(drawn.slopes.pose[row], drawn.slopes.pose_by[row])
    return TipVector(drawn.parameters, drawn.theta[row], drawn.l[row], slopes, part, target, base)


def _as_angle(chord: WorstCase, play_rad: float) -> WorstCase:
    """[rad] of a chord on the unit sphere, shares in proportion, and play of the drive added."""
    angle = 2 * float(np.arcsin(min(chord.size / 2, 1.0))) if np.isfinite(chord.size) else np.inf
    scale = angle / chord.size if 0 < chord.size < np.inf else 1.0

    def scaled(values: Mapping[str, float]) -> dict[str, float]:
        return {name: scale * value for name, value in values.items()}

    given = scaled(chord.given) | ({PLAY: play_rad} if play_rad else {})
    return replace(
        chord,
        size=angle + play_rad,
        given=given,
        saved=scaled(chord.saved),
        beyond_first_order=scale * chord.beyond_first_order,
    )


def tour_miss(results: Sequence[StopJudged]) -> TourMiss | None:
    """None of less than two targets that can be missed."""
    results = [stop for stop in results if stop.aim.tolerance_m is not None]
    if len(results) < 2:
        return None
    histories = [(stop, stop.by_history) for stop in results if stop.by_history is not None]
    return TourMiss(
        targets=len(results),
        chance_any_friction=_any_missed([(stop, stop.any_friction) for stop in results]),
        chance_by_history=_any_missed(histories) if len(histories) == len(results) else None,
    )


def _any_missed(results: Sequence[tuple[StopJudged, Judged]]) -> Chance:
    missed = [judged.missed(stop.aim) for stop, judged in results]
    return chance(*(np.any(events, axis=0) for events in zip(*missed, strict=True)))


ON_LINE = 8  # samples along a line, evenly; and the one where the frictionless tip is farthest from it


def plan_stops(plan: PlannedMotion) -> tuple[Stop, ...]:
    """The targets of a plan as stops, in the order reached."""
    scenario, samples, reached = plan.scenario, plan.certificate.samples, plan.certificate.targets
    results: list[Stop] = []
    begin, first = 0, 0
    targets = scenario.targets[-len(reached) :]  # a certificate of one path knows of its end alone
    for goal, target in zip(targets, reached, strict=True):
        is_last = goal is scenario.goal
        end = len(samples.leg) - 1 if is_last else int(np.flatnonzero(samples.leg <= target.leg)[-1])
        rows = np.array([end]) if goal.line_m is None else _on_line(plan, goal, begin, end)
        turn = 0.0
        if goal.direction is not None:
            turn = play_turn(scenario.robot, *scenario.robot.drive.commanded(samples.joints[end]))
        results.append(Stop(goal, rows, first + np.arange(len(rows)), target.play_m, turn))
        begin, first = end, first + len(rows)
    return tuple(results)


def _on_line(plan: PlannedMotion, goal: Goal, begin: int, end: int) -> NDArray[np.int_]:
    """Samples from one to another, both among them."""
    assert goal.line_m is not None
    scenario, tips = plan.scenario, plan.certificate.samples.tip_m[begin : end + 1]
    located = scenario.located(tips)
    farthest = begin + int(np.argmax(distance_from_polyline(located, goal.line_m)))
    evenly = np.linspace(begin, end, min(end - begin + 1, ON_LINE)).round().astype(int)
    return np.union1d(evenly, farthest)


def plan_uncertainty(of: PlannedMotion | Scenario, joints: ArrayLike | None = None) -> Uncertainty:
    """Worst case and chance of missing the targets and of touching the anatomy, with the causes ranked.

    Of a plan, along the samples of its certificate; or of a scenario along `joints` (m,) or (K, m), rad or m, the last
    ones at its goal. A plan's friction is taken as any, and as simulated; without a plan as any, at the goal alone.
    Raises InputError.
    """
    if isinstance(of, PlannedMotion):
        if joints is not None:
            raise InputError("goes with a scenario, a plan has its own", key="joints")
        return _uncertainty(
            of.scenario, _Motion(of.certificate.samples.joints, plan_stops(of), of.certificate.samples.leg)
        )
    if not isinstance(of, Scenario):
        raise InputError("must be a Plan or a Scenario", key="of", value=of)
    if joints is None:
        raise InputError("is missing, a scenario needs joint values", key="joints")
    q, count = np.atleast_2d(numbers(joints, "joints")), len(of.robot.drive.joints)
    if q.ndim != 2 or q.shape[1] != count or not len(q) or not np.all(np.isfinite(q)):
        raise InputError(f"must be finite and have shape ({count},) or (K, {count}), not {q.shape}", key="joints")
    of.robot.drive.warn_of_degrees("joints", q)
    return _uncertainty(of, _Motion(q, (end_stop(of.goal, len(q) - 1),), None))


def stated_uncertainty(plan: PlannedMotion) -> Uncertainty | None:
    """The uncertainty of a plan whose robot or base is uncertain; None where nothing is stated."""
    scenario = plan.scenario
    exact = scenario.registration.is_exact and not scenario.robot.model_error_m
    if exact and not uncertain_parameters(scenario.robot).count:
        return None
    return plan_uncertainty(plan)


@dataclass(frozen=True, eq=False)
class _Motion:
    joints: Array  # (K, m)
    stops: tuple[Stop, ...]
    leg: NDArray[np.int_] | None  # (K,) of a plan, whose histories are simulated


def _uncertainty(scenario: Scenario, motion: _Motion) -> Uncertainty:
    parameters, registration = uncertain_parameters(scenario.robot), scenario.registration
    draws = Draws.of(parameters, registration, scenario.robot.model_error_m)
    rows = np.concatenate([stop.samples for stop in motion.stops])
    drawn = DrawnPoses.of(parameters, draws, *scenario.robot.drive.commanded(motion.joints[rows]))
    simulated = None
    if motion.leg is not None:
        path = DrivenPath(motion.joints, motion.leg, rows)
        simulated = SimulatedPoses.of(scenario, parameters, path, draws.offset, drawn.solved)
    last = len(motion.stops) - 1
    results = [judged(scenario, drawn, stop, last - k, simulated) for k, stop in enumerate(motion.stops)]
    *via, goal = (goal_miss(scenario, drawn, *pair) for pair in zip(motion.stops, results, strict=True))
    return Uncertainty(
        parameters=tuple(intervals(parameters)),
        position_sigma_m=registration.position_sigma_m,
        rotation_sigma_rad=registration.rotation_sigma_rad,
        model_error_m=scenario.robot.model_error_m,
        goal=goal,
        via=tuple(via),
        tour=tour_miss(results),
        closest=closest_approach(scenario, parameters, motion.joints),
        simulated=0 if simulated is None else len(simulated.beyond),
    )
