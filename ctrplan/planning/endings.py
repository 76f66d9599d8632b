"""How a plan ends: with motions by which every pair of tubes slips and forgets the friction that was before.

A pair that neither turns one way far enough nor slides on a plan's path remembers where it came from, and no correction
knows that. Two kinds of endings help. The tubes of such pairs turn to one side and back, and one of them slides out and
in again: the cheapest that erases what is left is driven. Or neighbouring tubes swing against each other with
decreasing amplitude (Section V-A), which releases friction where no translation can.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Progress, part_of
from ctrplan.certificate.arrival import FORGOTTEN
from ctrplan.certificate.certificate import Certificate, Settling
from ctrplan.certificate.certify import GoalTest, certify, frictionless_arrives
from ctrplan.certificate.uneven_friction import NEAR_LIMIT_M
from ctrplan.drive.drive import Drive
from ctrplan.drive.legs import merge_legs
from ctrplan.mechanics.history import OSCILLATION_DEG
from ctrplan.motion.checker import MotionChecker
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.scenario.prediction import FrictionStart, predict_end, predict_from, start_states

SIZES = (1.0, 2.0, 4.0)  # of what the friction law says erases all; simulations took up to 2.4 times as much
MOST_ENDINGS = 24  # that are simulated, the cheapest first


@dataclass(frozen=True, eq=False)
class Settled:
    """A path that ends by slip, certified; or the path as it was, and why."""

    corners: Array  # (K, m)
    certificate: Certificate
    note: str = ""


def erase(
    checker: MotionChecker,
    corners: Array,
    certificate: Certificate,
    *,
    goal_test: GoalTest = frictionless_arrives,
    starts: Sequence[FrictionStart] | None = None,
    progress: Progress | None = None,
) -> Settled:
    """The path (K, m) with the cheapest ending that erases what its friction remembers, where that is worth its price.

    It is where the arrival keeps the goal's tolerance only with it, or where the scenario's weight of errors at the
    goal says so. A line is followed to its end without one.
    """
    before, scenario = certificate.arrival, checker.scenario
    if before is None or scenario.goal.line_m is not None or len(corners) < 2:
        return Settled(corners, certificate)
    kept = [pair for pair, left in enumerate(before.erased) if left.kept >= FORGOTTEN]
    worth_mm = scenario.cost.error_goal * before.by_cause.past_m * MM_PER_M
    is_late = before.error_m - before.by_cause.offset_m > scenario.goal.tolerance_m and scenario.goal.tip_m is not None
    if not kept or not (is_late or worth_mm > scenario.cost.path + scenario.cost.stop):
        return Settled(corners, certificate)
    _, states = predict_end(scenario.robot, corners, start_states(scenario) if starts is None else starts)
    simulated = 0
    for price_mm, ending in _endings(checker, corners[-1], kept):
        if simulated == MOST_ENDINGS or not is_late and price_mm >= worth_mm:
            break
        way = np.concatenate([corners[-1:], ending])
        if not checker.along(way).valid:
            continue
        simulated += 1
        after = predict_from(scenario.robot, states, way)
        if not after.friction_spread[-1].max() < FORGOTTEN:
            continue
        longer = merge_legs(np.concatenate([corners, ending]))
        checked = certify(
            scenario, longer, goal_test=goal_test, starts=starts, restart=False, spare_m=NEAR_LIMIT_M, progress=progress
        )
        if checked.valid and checked.arrival and checked.arrival.by_cause.past_m < before.by_cause.past_m:
            was, now = (x.by_cause.past_m * MM_PER_M for x in (before, checked.arrival))
            erased = f"from {was:.2f} to {now:.2f} mm, for {price_mm:.0f} mm of cost"
            return Settled(longer, checked, f"The last {len(ending)} legs erase what friction remembers, {erased}.")
    pairs = " and ".join(f"{pair + 1}-{pair + 2}" for pair in kept)
    rest = f"up to {before.by_cause.past_m * MM_PER_M:.2f} mm at the tip stay unknown"
    return Settled(corners, certificate, f"No ending within limits and margins makes tubes {pairs} slip: {rest}.")


def _endings(checker: MotionChecker, joints: Array, pairs: list[int]) -> list[tuple[float, Array]]:
    """Prices [mm] and waypoints (W, m) of motions that leave joints (m,) and come back to them, the cheapest first."""
    drive, space, cost = checker.space.drive, checker.space, checker.scenario.cost
    law = friction_law(checker.scenario.robot)
    turned_rad = 2 * float(law.loading_rad[pairs].max())  # from the Coulomb limit on one side to the other
    slid_m = float(law.forgets_m(FORGOTTEN)[pairs].max())
    turns = [np.zeros(len(joints))]
    for turn in (*turnings(drive), *np.eye(len(joints))[drive.is_rotation]):
        if any(abs(np.diff(drive.matrix_theta @ turn)[pair]) > FEASIBLE for pair in pairs):
            turns += [side * size * turned_rad * turn for side in (1, -1) for size in SIZES]
    slides = [np.zeros(len(joints))]
    for slide in np.eye(len(joints))[~drive.is_rotation]:
        slides += [side * size * slid_m * slide for side in (-1, 1) for size in SIZES if np.isfinite(slid_m)]
    results = []
    for turn in turns:
        for slide in slides:
            moves = [move for move in (turn, slide) if move.any()]
            ending = np.array([row for move in moves for row in (joints + move, joints)])
            if moves and space.allowed(ending):
                length = 2 * sum(space.length_mm(move) for move in moves)
                terms_mm = checker.terms_mm(np.concatenate([joints[None], ending]))
                results.append((cost.path * length + cost.stop * len(ending) + sum(terms_mm), ending))
    return sorted(results, key=lambda pair: pair[0])


AMPLITUDES_DEG = (40, 25, 15, 8)  # of the first turn, tried in this order; 40 is the paper's
SHAPE = np.array(OSCILLATION_DEG) / OSCILLATION_DEG[0] * (-1.0) ** np.arange(len(OSCILLATION_DEG))
FEASIBLE = 1e-9  # rad per rad that joints may miss the turns of the tubes by


def settle(
    checker: MotionChecker,
    corners: Array,
    certificate: Certificate,
    *,
    goal_test: GoalTest = frictionless_arrives,
    starts: Sequence[FrictionStart] | None = None,
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
        reporter = part_of(progress, k, len(AMPLITUDES_DEG))
        ways = [turns for turns in turnings(checker.space.drive) if _valid(checker, corners[-1], amplitude * turns)]
        for j, turns in enumerate(_best_first(checker, corners, amplitude, ways)):
            swung = np.concatenate([corners, oscillation(corners[-1], amplitude * turns)])
            way_reporter = part_of(reporter, j, len(ways))
            checked = certify(
                checker.scenario, swung, goal_test=goal_test, starts=starts, restart=False, progress=way_reporter
            )
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
