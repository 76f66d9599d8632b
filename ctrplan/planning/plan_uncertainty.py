"""`ctrplan.uncertainty`: what is known of a robot and its base by intervals only, and what that may do to a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError
from ctrplan.planning.planned_motion import PlannedMotion
from ctrplan.planning.scenario import Scenario
from ctrplan.planning.target_chances.aim import Stop, end_stop
from ctrplan.planning.target_chances.drawn_poses import DrawnPoses
from ctrplan.planning.target_chances.simulated_poses import DrivenPath, SimulatedPoses
from ctrplan.planning.target_chances.stops import plan_stops
from ctrplan.planning.target_chances.target_miss import goal_miss, judged
from ctrplan.planning.target_chances.tour_miss import tour_miss
from ctrplan.planning.uncertainty.chance import Draws
from ctrplan.planning.uncertainty.closest_approach import closest_approach
from ctrplan.planning.uncertainty.result import Uncertainty, intervals
from ctrplan.uncertain.parameters import uncertain_parameters


def uncertainty(of: PlannedMotion | Scenario, joints: ArrayLike | None = None) -> Uncertainty:
    """Worst case and chance of missing the targets and of touching the anatomy, with the causes ranked.

    Of a plan, along the samples of its certificate; or of a scenario along `joints` (m,) or (K, m), rad or m, the last
    ones at its goal. A plan's friction is taken as any, and as simulated; without a plan as any, at the goal alone.
    Raises InputError.
    """
    if isinstance(of, PlannedMotion):
        if joints is not None:
            raise InputError("goes with a scenario, a plan has its own", key="joints")
        return _found(of.scenario, _Motion(of.certificate.samples.joints, plan_stops(of), of.certificate.samples.leg))
    if not isinstance(of, Scenario):
        raise InputError("must be a Plan or a Scenario", key="of", value=of)
    if joints is None:
        raise InputError("is missing, a scenario needs joint values", key="joints")
    q, count = np.atleast_2d(numbers(joints, "joints")), len(of.robot.drive.joints)
    if q.ndim != 2 or q.shape[1] != count or not len(q) or not np.all(np.isfinite(q)):
        raise InputError(f"must be finite and have shape ({count},) or (K, {count}), not {q.shape}", key="joints")
    return _found(of, _Motion(q, (end_stop(of.goal, len(q) - 1),), None))


def plan_uncertainty(plan: PlannedMotion) -> Uncertainty | None:
    """Of a plan whose robot or base is uncertain; None where nothing is stated."""
    scenario = plan.scenario
    exact = scenario.registration.is_exact and not scenario.robot.model_error_m
    if exact and not uncertain_parameters(scenario.robot).count:
        return None
    return uncertainty(plan)


@dataclass(frozen=True, eq=False)
class _Motion:
    joints: Array  # (K, m)
    stops: tuple[Stop, ...]
    leg: NDArray[np.int_] | None  # (K,) of a plan, whose histories are simulated


def _found(scenario: Scenario, motion: _Motion) -> Uncertainty:
    parameters, registration = uncertain_parameters(scenario.robot), scenario.registration
    draws = Draws.of(parameters, registration, scenario.robot.model_error_m)
    rows = np.concatenate([stop.samples for stop in motion.stops])
    drawn = DrawnPoses.of(parameters, draws, *scenario.robot.drive.commanded(motion.joints[rows]))
    simulated = None
    if motion.leg is not None:
        path = DrivenPath(motion.joints, motion.leg, rows)
        simulated = SimulatedPoses.of(scenario, parameters, path, draws.offset, drawn.solved)
    last = len(motion.stops) - 1
    found = [judged(scenario, drawn, stop, last - k, simulated) for k, stop in enumerate(motion.stops)]
    *via, goal = (goal_miss(scenario, drawn, *pair) for pair in zip(motion.stops, found, strict=True))
    return Uncertainty(
        parameters=tuple(intervals(parameters)),
        position_sigma_m=registration.position_sigma_m,
        rotation_sigma_rad=registration.rotation_sigma_rad,
        model_error_m=scenario.robot.model_error_m,
        goal=goal,
        via=tuple(via),
        tour=tour_miss(found),
        closest=closest_approach(scenario, parameters, motion.joints),
        simulated=0 if simulated is None else len(simulated.beyond),
    )
