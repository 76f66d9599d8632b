"""Compensation: the last joint values are changed so that the tip with friction arrives, not the frictionless one.

The middle of where the motion ends, from any friction state before it, is brought to the target by the simulated
motion itself: the error that it leaves moves the joints, and it is simulated again until nothing is left. What is
certified is the corrected motion. A line is followed likewise, place by place.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Progress, part_of
from ctrplan.certificate.arrival import beside_nominal, friction_variants
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import finished, predicted_arrives
from ctrplan.certificate.walked_legs import WalkedLegs, walk_legs
from ctrplan.drive.drive import JOINT_ROUNDING
from ctrplan.mechanics.history import HistoryState
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.endings import settled_again
from ctrplan.planning.reach import tips_by_joints
from ctrplan.plans.planned_motion import Compensation
from ctrplan.scenario.prediction import (
    TIP_TOLERANCE_M,
    FrictionStart,
    frictionless_tips,
    offset_m,
    predict_end,
    predict_from,
    start_states,
)
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.tip_solver import DAMPING, target_in_robot_frame
from ctrplan.uncertainty.target import TargetPose

ITERATIONS = 8
ROUNDS = 2  # of corrections: of what the first could not certify, and of a line with corners put in; a budget
LOOKED_AT = 4  # places between corners of a line, a budget
CLOSE_M = 0.02e-3  # of the predicted tip to the target; better than histories are simulated
REFINED = 2  # times that the middle over all coefficients of friction is looked at again, a budget
LONGEST_STEP_MM = 10.0  # of joint length
SHARES = (0.5, 0.25)  # of a correction, tried where no whole one is certified
MOST_WAYS = 4 + len(SHARES)


@dataclass(frozen=True, eq=False)
class Compensated:
    """A path that was corrected and certified; or the path as it was, and why."""

    corners: Array  # (K, m)
    certificate: Certificate
    compensation: Compensation


@dataclass(frozen=True, eq=False)
class _Corrected:
    """A path that is to be certified."""

    corners: Array  # (K, m)
    delta: Array  # (m,) change of its end
    is_whole: bool  # else part of the way


def compensate(
    checker: MotionChecker,
    corners: Array,
    certificate: Certificate,
    driven: WalkedLegs | None = None,
    *,
    starts: Sequence[FrictionStart] | None = None,
    progress: Progress | None = None,
) -> Compensated:
    """The path (K, m) with its last legs changed so that the middle of its arrival meets the goal's tip.

    The change stays within limits and margins, and the target within the worst-case envelope of the commanded
    configuration; the path is certified again. Changing the last legs costs no stop, but moves the body all along them.
    Where that is not certified, two short legs at the end correct the path, or slides alone, or part of the change is
    made. Where the corrected path is known to be about what was `driven`, that is tried first. A path that can't be
    improved so is returned as it was.
    """
    start_friction = start_states(checker.scenario) if starts is None else list(starts)
    without = arrival_error(certificate)
    best = Compensated(corners, certificate, Compensation(np.zeros(corners.shape[1]), without, without, ""))
    if is_on_target(certificate) or len(corners) < 2:
        return best
    is_beyond_limits = False
    for turn in range(ROUNDS):
        before = best
        reporter = part_of(progress, turn, ROUNDS)
        best, is_stopped = _corrected_once(checker, before, None if turn else driven, start_friction, starts, reporter)
        is_beyond_limits |= is_stopped
        if best is before or is_on_target(best.certificate):
            break
    if is_on_target(best.certificate):
        return best
    within = "the joints' limits" if is_beyond_limits else "limits, margins and the worst-case envelope"
    why = f"no correction within {within} brings the predicted tip nearer"
    if best.certificate.arrival:
        why = f"{best.certificate.arrival.by_cause.offset_m * MM_PER_M:.2f} mm of the known offset: {why}"
    return replace(best, compensation=replace(best.compensation, note=why))


def _corrected_once(
    checker: MotionChecker,
    before: Compensated,
    driven: WalkedLegs | None,
    start_friction: Sequence[FrictionStart],
    starts: Sequence[FrictionStart] | None,
    progress: Progress | None,
) -> tuple[Compensated, bool]:
    """The first certified correction that brings a path nearer, itself without one; and whether a joint's limit stopped
    any.
    """
    is_beyond_limits, corners = False, before.corners
    known = [] if driven is None else [_Corrected(driven.corners, driven.corners[-1] - corners[-1], True)]
    for k, way in enumerate(
        itertools.chain(known, _corrected_ways(checker, corners, before.certificate, start_friction))
    ):
        moved = way.corners
        is_beyond_limits |= _is_at_limit(checker, moved[-1], way.delta)
        if not checker.space.allowed(moved):
            is_beyond_limits = True
            continue
        reporter = part_of(progress, k, MOST_WAYS)
        walk = driven if driven and k == 0 else walk_legs(checker.scenario, moved, progress=reporter)
        if walk.problems:  # no history makes it valid
            continue
        checked = finished(walk, predicted_arrives, starts)
        error = arrival_error(checked)
        if checked.valid and error < before.compensation.error_with_m:
            if settling := before.certificate.settling:
                checked = replace(checked, settling=settled_again(settling, checked, len(moved) - len(corners)))
            whole = replace(
                before.compensation, correction=before.compensation.correction + way.delta, error_with_m=error
            )
            return Compensated(moved, checked, whole), is_beyond_limits  # the next round corrects what is left
    return before, is_beyond_limits


def _is_at_limit(checker: MotionChecker, joints: Array, delta: Array) -> bool:
    """Whether a joint that a correction moved stands at its limit."""
    drive = checker.space.drive
    stands = np.any(np.isclose(joints, [drive.lower, drive.upper], atol=JOINT_ROUNDING), axis=0)
    return bool(np.any(stands & (delta != 0)))


def aimed(checker: MotionChecker, corners: Array, beside: Array | None = None) -> tuple[MotionChecker, Array]:
    """A checker whose goal is where the frictionless tip has to end so that the tip with friction arrives, and the path
    (K, m) moved there, valid or not, as it costs when it is compensated; both as they are where that is not possible.

    Friction at the end of the moved path has to leave the same offset, which it does not where it turns round. With
    `beside`, a path near by, what the starts differ by at the end is taken from there.
    """
    scenario, goal = checker.scenario, checker.scenario.goal
    if goal.tip_m is None or goal.joints is not None or goal.line_m is not None or len(corners) < 2:
        return checker, corners
    offset, before, near = offset_m(scenario, corners, beside), None, (checker, corners)
    simulated = corners if beside is None else beside
    for _ in range(ITERATIONS):
        if not np.isfinite(offset).all():
            break
        there = replace(goal, tip_m=goal.tip_m - scenario.base_R @ offset)
        other = MotionChecker(replace(scenario, goal=there), checker.style, checker.meter, checker.reserve_m)
        other.watch = checker.watch
        moved = brought_to_goal(other, corners)
        if moved is None:
            break
        change = offset_m(scenario, moved, simulated) - offset
        if np.linalg.norm(change) <= TIP_TOLERANCE_M:
            if beside is None:  # near enough to be simulated itself
                simulated, before, change = moved, None, offset_m(scenario, moved) - offset
            if np.linalg.norm(change) <= TIP_TOLERANCE_M:
                near = other, moved
        if np.linalg.norm(change) <= CLOSE_M:
            break
        step = change
        if before is not None:  # Anderson's: where the last two changes, drawn on, would be none
            turned = change - before[1]
            drawn_on = float(change @ turned) / max(float(turned @ turned), 1e-18)
            step = change - drawn_on * (offset - before[0] + turned)
        before, offset = (offset, change), offset + step
    return near


def brought_to_goal(checker: MotionChecker, corners: Array) -> Array | None:
    """The path (K, m) with its last legs moved so that the frictionless tip ends at the goal; None where it can't."""
    robot, is_rotation, delta = checker.scenario.robot, checker.space.drive.is_rotation, np.zeros(corners.shape[1])
    for _ in range(ITERATIONS):
        path = corrected(corners, len(corners) - 1, is_rotation, delta)
        if not checker.space.allowed(path):
            return None
        tip_m, tangent = frictionless_tips(robot, path[-1:])
        miss = target_in_robot_frame(checker.scenario) - tip_m[0]
        if not np.linalg.norm(miss) > CLOSE_M:
            return path
        delta = delta + _newton_step(checker, path[-1], miss, tangent[0], np.ones(len(delta), bool))
    return None


def on_target(checker: MotionChecker, corners: Array) -> Array:
    """A path (K, m) that a search moved, with its last legs moved by what histories of ordinary steps still miss."""
    scenario, place = checker.scenario, _CorrectedEnd(corners, len(corners) - 1)
    aim, nothing = target_in_robot_frame(scenario), np.zeros(corners.shape[1])
    delta = _correction(checker, place, aim, start_states(scenario), nothing)
    path = place.path(checker.space.drive.is_rotation, delta)
    return path if checker.space.allowed(path) else corners


def arrival_error(certificate: Certificate) -> float:
    """[m] of the arrival; inf where a history found no equilibrium."""
    return certificate.arrival.error_m if certificate.arrival else np.inf


def is_on_target(certificate: Certificate) -> bool:
    """Whether the middle of the arrival is at the target."""
    return certificate.arrival is not None and certificate.arrival.by_cause.offset_m <= TIP_TOLERANCE_M


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
    return np.insert(moved, 0, corners[0], axis=0) if not len(rotations) and turn.any() else moved


def shifted_start(corners: Array, is_rotation: NDArray[np.bool_], delta: Array, *, keeps_end: bool) -> Array:
    """The path (K, m) of a stage whose start was moved by delta (m,): moved as a whole, or back before its end."""
    moved = corners + delta
    return corrected(moved, len(moved) - 1, is_rotation, -delta) if keeps_end and len(moved) > 1 else moved


def _corrected_ways(
    checker: MotionChecker, corners: Array, certificate: Certificate, starts: Sequence[FrictionStart]
) -> Iterator[_Corrected]:
    """Corrected paths: in their last legs, in legs of their own at the end, by slides alone, and parts of the way."""
    if checker.scenario.goal.line_m is not None:
        whole, moved = _corrected_line(checker, corners, certificate, starts)
        for share in (1.0, *SHARES):
            yield _Corrected(whole + share * (moved - whole), share * (moved[-1] - whole[-1]), share == 1)
        return
    legs = certificate.settling.first_leg if certificate.settling else len(corners) - 1
    places = [_CorrectedEnd(corners, legs), _CorrectedEnd(corners, legs, slides_alone=True)]
    if not certificate.settling:  # nothing comes after an oscillation
        places.insert(1, _CorrectedEnd(corners, legs, of_its_own=True))
    scenario, deltas = checker.scenario, list[Array]()
    is_interval, is_rotation = bool(friction_variants(scenario.robot)), checker.space.drive.is_rotation
    for place in places:
        ends_m = certificate.goal_predicted_tip_m if certificate.arrival else None
        delta = _correction(checker, place, _aim(scenario, certificate), starts, np.zeros(corners.shape[1]), ends_m)
        for _ in range(REFINED if is_interval else 0):
            aim = target_in_robot_frame(scenario) - beside_nominal(scenario, place.path(is_rotation, delta), starts)
            delta = _correction(checker, place, aim, starts, delta)
        deltas.append(delta)
        if delta.any():
            yield _Corrected(place.path(is_rotation, delta), delta, True)
    for delta in (share * deltas[0] for share in SHARES if deltas[0].any()):
        yield _Corrected(places[0].path(is_rotation, delta), delta, False)


@dataclass(frozen=True, eq=False)
class _CorrectedEnd:
    """Where on a path its end is corrected."""

    corners: Array  # (K, m)
    legs: int  # before an oscillation that ends the path
    of_its_own: bool = False  # in two short legs at the end, the path before them as it was
    slides_alone: bool = False  # by translations, which take the body along its own track

    def path(self, is_rotation: NDArray[np.bool_], delta: Array) -> Array:
        """The path whose end is changed by delta (m,)."""
        if not self.of_its_own:
            return corrected(self.corners, self.legs, is_rotation, delta)
        end, kinds = self.corners[-1], (is_rotation, ~is_rotation)
        added = zip((end + np.where(is_rotation, delta, 0.0), end + delta), kinds, strict=True)
        return np.vstack([self.corners, *(row for row, kind in added if delta[kind].any())])

    def unchanged(self, is_rotation: NDArray[np.bool_]) -> int:
        """Index of the last corner before any change."""
        changed = self.path(is_rotation, np.ones(self.corners.shape[1]))[: len(self.corners)]
        same = np.all(changed == self.corners, axis=1)
        return len(self.corners) - 1 if same.all() else max(int(np.argmin(same)) - 1, 0)


def _aim(scenario: Scenario, certificate: Certificate) -> Array:
    """(3,) where the nominal robot's tips shall end so that the middle over all coefficients is at the target."""
    target = target_in_robot_frame(scenario)
    nominal = certificate.goal_predicted_tip_m
    return target - (certificate.arrival.middle_m - nominal) if certificate.arrival else target


def _correction(
    checker: MotionChecker,
    place: _CorrectedEnd,
    aim: Array,
    starts: Sequence[FrictionStart],
    delta: Array,
    ends_m: Array | None = None,
) -> Array:
    """(m,) change of joints whose simulated path ends nearest to the aim: damped Newton steps from delta (m,).

    Only what follows the first changed corner is simulated again, and not the path with delta whose end `ends_m` (3,)
    is known.
    """
    robot, is_rotation = checker.scenario.robot, checker.space.drive.is_rotation
    unchanged, states = place.unchanged(is_rotation), list[HistoryState]()
    best = (np.inf, delta)
    for k in range(ITERATIONS):
        path, tangent = place.path(is_rotation, delta), None
        if not checker.space.allowed(path):
            break
        if k or ends_m is None or checker.scenario.goal.direction is not None:
            if not states and not (states := predict_end(robot, place.corners[: unchanged + 1], starts)[1]):
                break
            prediction = predict_from(robot, states, path[unchanged:])
            miss, tangent = aim - prediction.end_middle_m, prediction.tangent[:, -1].mean(axis=0)
        else:
            miss = aim - ends_m
        distance = float(np.linalg.norm(miss))
        is_nearer = distance < best[0] - CLOSE_M / 2  # else the joints that may move bring the tip no farther
        if distance < best[0]:
            best = (distance, delta)
        if not is_nearer or not CLOSE_M / 2 < distance < np.inf:
            break
        movable = ~is_rotation if place.slides_alone else np.ones(len(delta), bool)
        step = _newton_step(checker, path[-1], miss, tangent, movable)
        if not step.any():
            break
        delta = delta + step
    return best[1]


def _corrected_line(
    checker: MotionChecker, corners: Array, certificate: Certificate, starts: Sequence[FrictionStart]
) -> tuple[Array, Array]:
    """A path along a line, and the same with all corners but the first moved so that predicted tips are on the line.

    Both (K, m). Corners are put where the tip leaves the line between those that there are: on the first way after a
    reversal friction builds up, and the tip does not follow the joints in proportion.
    """
    moved = _on_line(checker, corners, certificate, starts)
    for _ in range(ROUNDS):
        leg, share = _off_between(checker, moved, starts)
        if not len(leg):
            break
        corners, moved = (
            np.insert(path, leg + 1, path[leg] + share[:, None] * (path[leg + 1] - path[leg]), axis=0)
            for path in (corners, moved)
        )
        moved = _on_line(checker, moved, certificate, starts)
    return corners, moved


def _line(checker: MotionChecker, corners: Array) -> TargetPose:
    """The goal's line, where a path (K, m) follows it."""
    scenario = checker.scenario
    return TargetPose.of(scenario, scenario.goal, frictionless_tips(scenario.robot, corners[-1:])[0][0])


def _off_between(
    checker: MotionChecker, corners: Array, starts: Sequence[FrictionStart]
) -> tuple[NDArray[np.int_], Array]:
    """Legs (L,) of a path (K, m) on which the predicted tip is off the line, and the shares (L,) of them where most."""
    shares = np.linspace(0, 1, LOOKED_AT + 2)[1:]
    rows = (corners[:-1, None] + shares[None, :, None] * np.diff(corners, axis=0)[:, None]).reshape(
        -1, corners.shape[1]
    )
    tips = predict_end(checker.scenario.robot, np.vstack([corners[:1], rows]), starts)[0].tip_m[:, 1:]
    line = _line(checker, corners)
    off = np.max([line.off_m(row, is_end=False) for row in tips], axis=0).reshape(len(corners) - 1, -1)[:, :-1]
    leg = np.flatnonzero(off.max(axis=1) > TIP_TOLERANCE_M)
    return leg, shares[np.argmax(off[leg], axis=1)]


def _on_line(
    checker: MotionChecker, corners: Array, certificate: Certificate, starts: Sequence[FrictionStart]
) -> Array:
    """The corners (K, m) of a path along a line, all but the first moved until predicted tips there are on the line."""
    robot, line = checker.scenario.robot, _line(checker, corners)
    targets = np.array([line.nearest_m(tip_m, is_end=False) for tip_m in frictionless_tips(robot, corners)[0]])
    targets[-1] = _aim(checker.scenario, certificate)
    best, moved = (np.inf, corners), np.array(corners)
    every = np.ones(corners.shape[1], bool)
    for _ in range(ITERATIONS):
        prediction = predict_end(robot, moved, starts)[0]
        misses = targets - prediction.tip_m.mean(axis=0)
        worst = float(np.linalg.norm(misses[1:], axis=1).max())
        if worst < best[0]:
            best = (worst, np.array(moved))
        if not CLOSE_M < worst < np.inf:
            break
        for k in range(1, len(moved)):
            moved[k] += _newton_step(checker, moved[k], misses[k], None, every)
    return best[1]


def _newton_step(
    checker: MotionChecker, joints: Array, miss: Array, tangent: Array | None, movable: NDArray[np.bool_]
) -> Array:
    """(m,) damped least-squares step of movable joints in mm-weighted lengths, within limits and nesting.

    Joints that can't move on stay where they are, and the others take over. What the position leaves free turns the
    tip's tangent (3,) to the goal's direction, where there is one.
    """
    space, goal, free = checker.space, checker.scenario.goal, movable.copy()
    slopes = tips_by_joints(checker, joints[None], np.zeros((1, checker.mechanics.n - 1)))
    position, direction = (by[0] / space.weights_mm * MM_PER_M for by in (slopes.position_by, slopes.tangent_by))
    for _ in range(len(joints)):
        J = np.where(free, position, 0.0)
        inverse = J.T @ np.linalg.inv(J @ J.T + DAMPING * np.eye(3))
        step = inverse @ (miss * MM_PER_M)
        if goal.direction is not None and tangent is not None:
            turned = checker.scenario.base_R.T @ goal.direction - tangent
            D = np.where(free, direction, 0.0) @ (np.eye(len(joints)) - inverse @ J)
            step = step + np.linalg.pinv(D, rcond=1e-3) @ (turned * MM_PER_M - D @ step)
        step *= min(1.0, LONGEST_STEP_MM / max(float(np.linalg.norm(step)), 1e-12))
        step = np.where(free, step / space.weights_mm, 0.0)
        clipped: Array = space.projected((joints + step)[None], fallback=joints[None])[0] - joints
        stopped = free & (clipped != step) & (np.abs(clipped) <= 1e-12)
        if not stopped.any():
            break
        free &= ~stopped
    return clipped
