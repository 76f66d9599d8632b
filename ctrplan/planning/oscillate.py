"""Settling: a plan may end with the oscillation of decreasing amplitude of Section V-A.

It releases friction where no translation can.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Progress, part_of
from ctrplan.certificate.certificate import Certificate, Settling
from ctrplan.certificate.certify import Arrival, certify, frictionless_arrives
from ctrplan.drive.drive import Drive
from ctrplan.mechanics.history import OSCILLATION_DEG
from ctrplan.motion.checker import MotionChecker
from ctrplan.scenario.prediction import predict_end, predict_from

AMPLITUDES_DEG = (40, 25, 15, 8)  # of the first turn, tried in this order; 40 is the paper's
SHAPE = np.array(OSCILLATION_DEG) / OSCILLATION_DEG[0] * (-1.0) ** np.arange(len(OSCILLATION_DEG))
FEASIBLE = 1e-9  # rad per rad that joints may miss the turns of the tubes by


@dataclass(frozen=True, eq=False)
class Settled:
    """A path that ends with an oscillation, certified; or the path as it was, and why."""

    corners: Array  # (K, m)
    certificate: Certificate
    note: str = ""


def settle(
    checker: MotionChecker,
    corners: Array,
    certificate: Certificate,
    *,
    arrival: Arrival = frictionless_arrives,
    progress: Progress | None = None,
) -> Settled:
    """The path (K, m) with the largest valid oscillation at its end, if that lowers the predicted error there.

    Neighbouring tubes turn against each other by the amplitude to one side and the other; of the ways to share the
    turns among the joints, the one that leaves the smallest error is taken. A line is followed to its end without one.
    """
    if checker.scenario.goal.line_m is not None:
        reason = "it would take the tip off the line"
        return Settled(corners, certificate, f"The settling oscillation was left out: {reason}.")
    before = certificate.goal_predicted_m
    for k, amplitude in enumerate(np.radians(AMPLITUDES_DEG)):
        told = part_of(progress, k, len(AMPLITUDES_DEG))
        ways = [turns for turns in turnings(checker.space.drive) if _valid(checker, corners[-1], amplitude * turns)]
        for j, turns in enumerate(_best_first(checker, corners, amplitude, ways)):
            swung = np.concatenate([corners, oscillation(corners[-1], amplitude * turns)])
            checked = certify(checker.scenario, swung, arrival=arrival, progress=part_of(told, j, len(ways)))
            if not checked.valid:
                continue
            if checked.goal_predicted_m >= before:
                left, result = checked.goal_predicted_m * MM_PER_M, before * MM_PER_M
                reason = f"it would leave a predicted error of {left:.2f} mm instead of {result:.2f} mm"
                return Settled(corners, certificate, f"The settling oscillation was left out: {reason}.")
            swing = Settling(float(amplitude), turns, len(corners) - 1, np.inf, before, np.inf)
            return Settled(swung, replace(checked, settling=settled_again(swing, checked, 0)))
    reason = f"none of {AMPLITUDES_DEG[-1]} to {AMPLITUDES_DEG[0]} deg keeps limits and margins"
    return Settled(corners, certificate, f"The settling oscillation was left out: {reason}.")


def oscillation(joints: Array, turn: Array) -> Array:
    """(21, m) waypoints that swing about joints (m,) by turn (m,) and less and less of it, ending at joints."""
    return joints + SHAPE[:, None] * turn


def turnings(drive: Drive) -> Iterator[Array]:
    """Joint motions (m,) that turn neighbouring tubes by 1 rad against each other, all pairs or one of them.

    All pairs: in the same sense, with the inner, outer or middle tubes turning least, or in alternating senses.
    """
    n = len(drive.home_theta_rad)
    order, alternating = np.arange(n, dtype=np.float64), np.arange(n) % 2.0
    patterns = [order, order - order.mean(), order - order[-1], alternating, alternating - 1]
    patterns += [np.where(order > pair, 1.0, 0.0) for pair in range(n - 1) if n > 2]
    for tubes in patterns:
        turn = np.linalg.lstsq(drive.matrix_theta, tubes, rcond=None)[0]
        if n > 1 and np.abs(drive.matrix_theta @ turn - tubes).max() < FEASIBLE:
            yield turn


def _valid(checker: MotionChecker, joints: Array, turn: Array) -> bool:
    """The two widest swings; all others lie between them."""
    return checker.along(np.concatenate([joints[None], oscillation(joints, turn)[:2], joints[None]])).valid


def _best_first(checker: MotionChecker, corners: Array, amplitude: float, ways: list[Array]) -> list[Array]:
    """The ways by the predicted error they leave, from the released start: all starts are alike by then."""
    if len(ways) < 2:
        return ways
    robot = checker.scenario.robot
    _, states = predict_end(robot, corners, ["released"])
    goal = robot.drive.collars(corners[-1:])
    tip = robot.mechanics.tips_with_friction(*goal, np.zeros((1, robot.n - 1))).position_m
    errors = []
    for turns in ways:
        rows = np.concatenate([corners[-1:], oscillation(corners[-1], amplitude * turns)])
        error = float(predict_from(robot, states, rows).errors(tip)[-1])
        errors.append(error if np.isfinite(error) else np.inf)
    return [ways[k] for k in np.argsort(errors)]


def settled_again(settling: Settling, certificate: Certificate, more_legs: int) -> Settling:
    """Settles with the same oscillation after legs before it were changed, or added."""
    first = settling.first_leg + more_legs
    while_settling = certificate.samples.leg >= first
    return replace(
        settling,
        first_leg=first,
        min_clearance_m=float(certificate.samples.clearance_m[while_settling].min()),
        goal_predicted_after_m=certificate.goal_predicted_m,
    )
