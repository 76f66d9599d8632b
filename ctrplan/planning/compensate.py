"""Compensation: the last joint values are changed so that the predicted tip, not the frictionless one, arrives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Progress, part_of
from ctrplan.certificate.certificate import Certificate, CertificateSamples
from ctrplan.certificate.certify import certify
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.oscillate import settled_again
from ctrplan.plans.planned_motion import Compensation
from ctrplan.robot.robot import Robot
from ctrplan.scenario.prediction import PathPrediction, predict_end, predict_from, start_states
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.tip_solver import target_in_robot_frame

ITERATIONS = 6
CLOSE_M = 0.02e-3  # of the predicted tip to the target; better than histories are simulated
DAMPING = 1e-4  # of the least-squares step, in units of (mm per mm) squared
LONGEST_STEP_MM = 10.0  # of joint length
SHARES = (1.0, 0.5, 0.25)  # of a correction, tried until one is certified


def compensate(
    checker: MotionChecker, corners: Array, certificate: Certificate, *, progress: Progress | None = None
) -> tuple[Array, Certificate, Compensation]:
    """The path (K, m) with its last legs changed so that the mean of the predicted tips meets the goal's tip.

    The change stays within limits and margins, and the target within the worst-case envelope of the commanded
    configuration; the path is certified again. A path that can't be improved so is returned as it was.
    """
    scenario, is_rotation = checker.scenario, checker.space.drive.is_rotation
    target = target_in_robot_frame(scenario)
    legs = certificate.settling.first_leg if certificate.settling else len(corners) - 1
    without = _arrival_error(certificate, target)
    full = _correction(checker, corners, legs, target)
    for k, share in enumerate(SHARES):
        delta = share * full
        moved = corrected(corners, legs, is_rotation, delta)
        if not delta.any() or not checker.space.allowed(moved):
            continue
        checked = certify(scenario, moved, arrival=predicted_arrives, progress=part_of(progress, k, len(SHARES)))
        error = _arrival_error(checked, target)
        if checked.valid and error < without:
            settling = certificate.settling
            if settling:
                checked = replace(checked, settling=settled_again(settling, checked, len(moved) - len(corners)))
            return moved, checked, Compensation(delta, without, error, "")
    why = "no correction within limits, margins and the worst-case envelope brings the predicted tip nearer"
    return corners, certificate, Compensation(np.zeros_like(full), without, without, why)


def corrected(corners: Array, legs: int, is_rotation: NDArray[np.bool_], delta: Array) -> Array:
    """Corners with joints changed by delta (m,) at the end of the last rotation and the last translation of the first
    `legs` legs, and everywhere after; a plan without such a leg gets one, at its start or its end.
    """
    moved = np.array(corners)
    turn, slide = np.where(is_rotation, delta, 0.0), np.where(is_rotation, 0.0, delta)
    steps = np.diff(corners[: legs + 1], axis=0)
    rotations, translations = (np.flatnonzero(np.any(steps[:, kind], axis=1)) for kind in (is_rotation, ~is_rotation))
    first = int(rotations[-1]) + 1 if len(rotations) else 0
    last = int(translations[-1]) + 1 if len(translations) else legs
    moved[first:] += turn
    moved[last:] += slide
    if not len(translations) and slide.any():
        moved = np.insert(moved, legs, corners[legs] + turn, axis=0)
    if not len(rotations) and turn.any():
        moved = np.insert(moved, 0, corners[0], axis=0)
    return moved


def predicted_arrives(scenario: Scenario, samples: CertificateSamples, prediction: PathPrediction) -> list[str]:
    """Sentences if a predicted tip misses the goal, or the target is outside the worst-case envelope."""
    target, tolerance, result = target_in_robot_frame(scenario), scenario.goal.tolerance_m, []
    error = float(np.linalg.norm(prediction.tip_m[:, -1] - target, axis=1).max())
    if not error <= tolerance:
        allowed = f"{tolerance * MM_PER_M:g} mm"
        result.append(f"The predicted tip ends {error * MM_PER_M:.2f} mm from the target, tolerance {allowed}.")
    shift, bound = float(np.linalg.norm(samples.tip_m[-1] - target)), float(samples.bound_m[-1])
    if not shift <= bound + tolerance:
        shown = (
            f"{shift * MM_PER_M:.2f} mm from the frictionless tip, the worst-case error is {bound * MM_PER_M:.2f} mm"
        )
        result.append(f"The target lies outside the worst-case envelope: {shown}.")
    return result


def _arrival_error(certificate: Certificate, target: Array) -> float:
    """How far [m] predicted tips may end from the target: their mean, plus what the start state may change."""
    error = float(np.linalg.norm(certificate.goal_predicted_tip_m - target)) + certificate.goal_predicted_spread_m
    return error if np.isfinite(error) else np.inf


def _correction(checker: MotionChecker, corners: Array, legs: int, target: Array) -> Array:
    """(m,) joint change whose simulated path ends nearest to the target: damped Newton steps from the plan's own end.

    Only what follows the first changed corner is simulated again.
    """
    robot, is_rotation = checker.scenario.robot, checker.space.drive.is_rotation
    unchanged = _unchanged(corners, legs, is_rotation)
    _, states = predict_end(robot, corners[: unchanged + 1], start_states(checker.scenario))
    delta: Array = np.zeros(corners.shape[1])
    best = (np.inf, delta)
    for _ in range(ITERATIONS):
        path = corrected(corners, legs, is_rotation, delta)
        if not checker.space.allowed(path):
            break
        miss = target - predict_from(robot, states, path[unchanged:]).end_middle_m
        distance = float(np.linalg.norm(miss))
        if distance < best[0]:
            best = (distance, delta)
        if not CLOSE_M < distance < np.inf:
            break
        delta = delta + _newton_step(checker, path[-1], miss)
    return best[1]


def _unchanged(corners: Array, legs: int, is_rotation: NDArray[np.bool_]) -> int:
    """Index of the last corner before any correction."""
    changed = corrected(corners, legs, is_rotation, np.ones(corners.shape[1]))
    same = np.all(changed[: len(corners)] == corners, axis=1)
    return max(int(np.argmin(same)) - 1, 0)


def _newton_step(checker: MotionChecker, joints: Array, miss: Array) -> Array:
    """(m,) damped least-squares step in mm-weighted joints, kept within limits; joints that can't move on stay."""
    space = checker.space
    scaled = tip_jacobian(checker.scenario.robot, joints) / space.weights_mm * MM_PER_M  # mm per mm
    step = scaled.T @ np.linalg.solve(scaled @ scaled.T + DAMPING * np.eye(3), miss * MM_PER_M)
    step *= min(1.0, LONGEST_STEP_MM / max(float(np.linalg.norm(step)), 1e-12)) / space.weights_mm
    clipped: Array = np.clip(joints + step, space.drive.lower, space.drive.upper) - joints
    return clipped


def tip_jacobian(robot: Robot, joints: Array) -> Array:
    """(3, m) derivative of the frictionless tip by actuated joints (m,), m per rad and m per m."""
    names = [f"{key}.{i + 1}" for key in ("theta_b", "l_b") for i in range(robot.n)]
    collars, moves = robot.drive.collars(joints[None]), robot.drive.collars_by_joints(joints[None])[0]
    moved = np.flatnonzero(moves.any(axis=1))
    tips = robot.mechanics.tips_with_friction(
        *collars, np.zeros((1, robot.n - 1)), parameters=[names[k] for k in moved.tolist()]
    )
    slopes = np.nan_to_num(tips.position_by[0])  # NaN where a collar or tip would pass another one
    jacobian: Array = slopes @ moves[moved]
    return jacobian
