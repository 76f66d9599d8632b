"""`ctrplan.plan_uncertainty`: what parameters and a registration known by intervals may do to a plan."""

from __future__ import annotations

from dataclasses import dataclass
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
from ctrplan.uncertainty.result import Uncertainty, closest_approach, intervals
from ctrplan.uncertainty.target import Stop, end_stop
from ctrplan.uncertainty.target_miss import goal_miss, judged, tour_miss
from ctrplan.uncertainty.worst_case import Draws

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Goal

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
            turn = play_turn(scenario.robot, *scenario.robot.drive.collars(samples.joints[end]))
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
