"""Following a line with the tip: joint values along it by continuous inverse kinematics, in few legs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.errors import NoAnswerError
from ctrplan.mechanics.shapes import Status
from ctrplan.motion.checker import MotionChecker
from ctrplan.scenario.scenario import Goal
from ctrplan.scenario.tip_solver import GoalState, TipSolver, TipTarget

SPACING_M = 2e-3  # of the points that are solved for
CORRECTIONS = 3  # of the zero-clearance target, so that the frictionless tip with clearance arrives
SHARE = 0.5  # of the tolerance that points on the line, and straight legs between them, may use each
BETWEEN = 5  # places of a leg that are looked at
MOST_BEGINNINGS = 6
LONGEST_JUMP_MM = 25.0  # of joint length between neighbouring points: beyond it the configuration has changed over


def follow_line(checker: MotionChecker, start: Array, goal: Goal) -> tuple[Array, str]:
    """Corners (K, m) that lead the tip from joint values `start` along the goal's line; else none, and why.

    Joints move together and straight between corners. The tip without friction stays within the goal's tolerance.
    """
    assert goal.line_m is not None
    scenario = checker.scenario
    line = (goal.line_m - scenario.base_position_m) @ scenario.base_R
    points = _points(line)
    joints, shift = [start], _shift(checker, start)
    if shift is None:
        return start[None], "the mechanics solver failed at the line's beginning"
    for point in points[1:]:
        result = _next(checker, joints[-1], point, shift, SHARE * goal.tolerance_m)
        if result is None:
            at = [round(float(x) * 1e3, 1) for x in scenario.base_R @ point + scenario.base_position_m]
            return start[None], f"the tip can't follow the line beyond {at} mm"
        q, shift = result
        joints.append(q)
    q = np.array(joints)
    corners = q[_corners(checker, q, line, SHARE * goal.tolerance_m)]
    motion = checker.along(corners)
    return corners, "" if motion.valid else motion.reason


def line_beginnings(checker: MotionChecker, goals: list[GoalState], line: Goal) -> list[GoalState]:
    """Those goals from which the line can be followed, at most MOST_BEGINNINGS; NoAnswerError without any."""
    kept, why = [], ""
    onward = MotionChecker(replace(checker.scenario, goal=line))
    for goal in goals:
        _, failed = follow_line(onward, goal.joints, line)
        why = why or failed
        if not failed:
            kept.append(goal)
        if len(kept) == MOST_BEGINNINGS:
            break
    if not kept:
        scenario = checker.scenario
        many = f"from none of {len(goals)} configurations at its beginning; first: {why}"
        raise NoAnswerError(f"{scenario.path or scenario.name}: {line.table}.line_mm: can't be followed {many}.")
    return kept


def _points(line: Array) -> Array:
    """(K, 3) points along a polyline, its corners among them."""
    points = [line[:1]]
    for a, b in zip(line[:-1], line[1:], strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / SPACING_M)))
        points.append(a + np.linspace(0, 1, count + 1)[1:, None] * (b - a))
    return np.concatenate(points)


def _shift(checker: MotionChecker, q: Array) -> Array | None:
    """(3,) zero-clearance tip less frictionless tip with clearance; None where either fails."""
    theta_b, l_b = checker.space.drive.collars(q)
    shape = checker.mechanics.solve(theta_b, l_b)
    tip, _, status = checker.mechanics.tips(theta_b[None], l_b[None], loads=False)
    if shape.status >= Status.UNSTABLE or status[0] != Status.CONVERGED:
        return None
    shift: Array = tip[0] - shape.tip_m
    return shift


def _next(checker: MotionChecker, q: Array, point: Array, shift: Array, within_m: float) -> tuple[Array, Array] | None:
    """Joint values at the next point of the line, near q, and the shift there."""
    solver = TipSolver(checker.space, checker.mechanics)
    for _ in range(CORRECTIONS):
        result = solver.solve(TipTarget(point + shift), q[None], turned=False)
        moved = result.joints[0]
        now = _shift(checker, moved)
        if now is None or checker.space.length_mm(moved - q) > LONGEST_JUMP_MM:
            return None
        if np.linalg.norm(result.tip_m[0] - now - point) <= 0.3 * within_m:
            return moved, now
        shift = now
    return None


def _corners(checker: MotionChecker, q: Array, line: Array, within_m: float) -> list[int]:
    """Rows of q (K, m) such that straight motions between them keep the zero-clearance tip by its own track."""
    solver = TipSolver(checker.space, checker.mechanics)
    track, _ = solver.tips(q)

    def split(a: int, b: int) -> list[int]:
        if b - a < 2:
            return [b]
        share = np.linspace(0, 1, max(BETWEEN, b - a) + 2)[1:-1, None]
        tips, _ = solver.tips(q[a] + share * (q[b] - q[a]))
        off = distance_from_polyline(tips, track[a : b + 1])
        if np.all(off <= within_m):
            return [b]
        middle = (a + b) // 2
        return split(a, middle) + split(middle, b)

    return [0, *split(0, len(q) - 1)]
