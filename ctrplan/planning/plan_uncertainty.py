"""`ctrplan.uncertainty`: what is known of a robot and its base by intervals only, and what that may do to a motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError
from ctrplan.planning.planned_motion import PlannedMotion
from ctrplan.planning.scenario import Scenario
from ctrplan.planning.uncertainty.closest_approach import closest_approach
from ctrplan.planning.uncertainty.goal_miss import PredictedTip, goal_miss
from ctrplan.planning.uncertainty.result import Uncertainty, intervals
from ctrplan.uncertain.parameters import uncertain_parameters


def uncertainty(of: PlannedMotion | Scenario, joints: ArrayLike | None = None) -> Uncertainty:
    """Worst case and chance of missing the goal and of touching the anatomy, with the causes ranked.

    Of a plan, along the samples of its certificate; or of a scenario along `joints` (m,) or (K, m), rad or m, the last
    ones at its goal. A plan's friction is taken as any, and as simulated; without a plan as any. Raises InputError.
    """
    if isinstance(of, PlannedMotion):
        if joints is not None:
            raise InputError("goes with a scenario, a plan has its own", key="joints")
        certificate = of.certificate
        predicted = PredictedTip(certificate.goal_predicted_tip_m, certificate.goal_predicted_spread_m)
        return _found(of.scenario, certificate.samples.joints, certificate.goal_play_m, predicted)
    if not isinstance(of, Scenario):
        raise InputError("must be a Plan or a Scenario", key="of", value=of)
    if joints is None:
        raise InputError("is missing, a scenario needs joint values", key="joints")
    q, count = np.atleast_2d(numbers(joints, "joints")), len(of.robot.drive.joints)
    if q.ndim != 2 or q.shape[1] != count or not len(q) or not np.all(np.isfinite(q)):
        raise InputError(f"must be finite and have shape ({count},) or (K, {count}), not {q.shape}", key="joints")
    return _found(of, q, 0.0, None)


def plan_uncertainty(plan: PlannedMotion) -> Uncertainty | None:
    """Of a plan whose robot or base is uncertain; None where nothing is stated."""
    scenario = plan.scenario
    exact = scenario.registration.is_exact and not scenario.robot.model_error_m
    if exact and not uncertain_parameters(scenario.robot).count:
        return None
    return uncertainty(plan)


def _found(scenario: Scenario, joints: Array, play_m: float, predicted: PredictedTip | None) -> Uncertainty:
    parameters, registration = uncertain_parameters(scenario.robot), scenario.registration
    return Uncertainty(
        parameters=tuple(intervals(parameters)),
        position_sigma_m=registration.position_sigma_m,
        rotation_sigma_rad=registration.rotation_sigma_rad,
        model_error_m=scenario.robot.model_error_m,
        goal=goal_miss(scenario, parameters, joints[-1], play_m, predicted),
        closest=closest_approach(scenario, parameters, joints),
    )
