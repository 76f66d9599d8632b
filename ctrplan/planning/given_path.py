"""Paths of anybody's planner: certified as they are, or improved first.

`certify` takes a path as it is. `reorder` merges and reorders its legs so that least friction error is left, and then
certifies what came out. Both want the path of the scenario: from its start past its targets, in their order, to its
goal, within limits.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import PROGRESS, Made, checked
from ctrplan.base.arrays import MM_PER_M, MOST_TURNS_DEG, Array, numbers
from ctrplan.base.long_work import Progress, part_of
from ctrplan.certificate.certificate import Certificate, joined_certificates
from ctrplan.certificate.certify import certify as certified_legs
from ctrplan.certificate.certify import either_arrives
from ctrplan.certificate.problems import PARTED
from ctrplan.certificate.walked_legs import miscounted
from ctrplan.drive.drive import SAME_JOINTS
from ctrplan.drive.legs import merge_legs, places_on_legs
from ctrplan.drive.trajectory import PERIOD, PERIOD_S, Trajectory
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import nearest_turn
from ctrplan.planning.reordering import assemble, least_error_order
from ctrplan.plans.plan import Plan
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.prediction import ball_centre, predict, start_states
from ctrplan.scenario.scenario import Goal
from ctrplan.scenario.start_branch import followed, led_on, standing
from ctrplan.scenario.tip_solver import angle_to

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario


@checked(scenario=Made("Scenario"), timing=Made("Trajectory"), progress=PROGRESS)
def certify(
    scenario: Scenario,
    path: ArrayLike | Trajectory,
    *,
    timing: Trajectory | None = None,
    progress: Progress | None = None,
) -> Certificate:
    """The certificate of a path as it is: waypoints (K, m) of actuated joints, straight in between, or a trajectory.

    timing: the trajectory that drives the waypoints; its times count where joints follow late. The certificate says in
    `valid` and `problems` whether the motion holds and the middle of its arrivals is within tolerance, and by
    `arrival.keeps(scenario.goal)` whether all of them are. Raises InputError, one sentence, for what is
    not the scenario's motion: another start, goal or direction, targets left out or out of order, limits, a trajectory
    beside the waypoints; and for waypoints alone, or several targets, of a robot whose joints follow unequally late:
    how far they leave the path depends on its timing.
    """
    given, timed = (path.position, path) if isinstance(path, Trajectory) else (path, timing)
    corners = _corners(scenario, given)
    scenario = standing(scenario, corners)
    timed = None if timed is None else _along(scenario, corners, timed)
    if timed is None or scenario.via:
        refuse_late_drive(scenario)
    space = JointSpace.of(scenario)
    if not space.allowed(corners):
        raise InputError(space.violation(corners), file=scenario.path, key="path")
    return _certified(scenario, _stages(scenario, corners), progress, timed, parts=True)


def _certified(
    scenario: Scenario,
    ways: list[Array],
    progress: Progress | None = None,
    timing: Trajectory | None = None,
    parts: bool = False,
) -> Certificate:
    """The certificate of ways from target to target; `timing` is that of a single one.

    parts: whether the shape that is followed may part from the one that is solved at the joints by themselves.
    """
    stages, start, starts, counted = list[Certificate](), scenario.start, None, scenario
    scenario = standing(scenario)
    for k, (goal, way) in enumerate(zip(scenario.targets, ways, strict=True)):
        stage = replace(scenario, start=start, goal=nearest_turn(scenario, start, goal), via=())
        reporter = part_of(progress, k, len(ways))
        given = timing if len(ways) == 1 else None
        certified = partial(certified_legs, goal_test=either_arrives, starts=starts, timing=given, progress=reporter)
        stages.append(certified(stage, way))
        first = next(iter(stages[-1].problems), "")  # of a start that is refused it says so
        if parts and any(words in first for words in PARTED) and scenario.robot.guide is None:
            scenario = followed(scenario, way[0])
            stages[-1] = certified(replace(stage, robot=scenario.robot), way)
        start, starts, scenario = way[-1], stages[-1].end_states or None, led_on(scenario, way)
    result = joined_certificates(stages)
    if lost := miscounted(counted, start, result.samples.tip_m[-1]):
        result = replace(result, valid=False, problems=(*result.problems, f"{lost}."))
    return result


@checked(scenario=Made("Scenario"), period_s=PERIOD)
def reorder(path: ArrayLike, scenario: Scenario, *, period_s: float = 0.01) -> Plan:
    """Plan that drives a path (K, m) of actuated joint values, from anyone's planner, at lower or equal cost.

    Consecutive waypoints are joined by straight lines as given; unlimited rotations keep their winding. The improved
    path is then certified as `certify` does. Raises InputError for a path of the wrong shape, or one that does not
    lead from the scenario's start to its goal, NoAnswerError if the path itself is not valid in the scenario.
    """
    began = time.monotonic()
    if scenario.via:
        rule = "has several targets; give the path of one, with the goal alone, at a time"
        raise InputError(rule, file=scenario.path, key="target")
    corners = _corners(scenario, path)
    scenario = standing(scenario, corners)
    if scenario.robot.drive.is_late and period_s != PERIOD_S:
        rule = f"must be {PERIOD_S:g} s: joints follow late, and the certificate follows that motion in time"
        raise InputError(rule, key="period_s", value=period_s, unit="s")
    space = JointSpace.of(scenario)
    if not space.allowed(corners):
        raise NoAnswerError(f"{scenario.path or scenario.name}: path: not valid: {space.violation(corners)}.")
    (way,) = _stages(scenario, corners)
    result = least_error_order(MotionChecker(scenario), way)
    if not result.motion_before.valid:
        raise NoAnswerError(f"{scenario.path or scenario.name}: path: not valid: {result.motion_before.reason}.")
    certificate = _certified(scenario, [result.after])
    scenario = standing(scenario, result.after)
    elapsed = time.monotonic() - began
    return assemble(scenario, [result], certificate, planner="given path", seed=0, clock_s=elapsed, period_s=period_s)


def _corners(scenario: Scenario, path: ArrayLike) -> Array:
    """Waypoints (K, m) of a path from the scenario's start. Raises InputError."""
    m = len(scenario.robot.drive.joints)
    if hasattr(path, "waypoints"):
        raise InputError("is a plan: plan.waypoints are meant", key="path")
    corners = numbers(path, "path").copy()
    if corners.ndim != 2 or corners.shape[1] != m or len(corners) < 2:
        raise InputError(f"must be of shape (K, {m}) with K >= 2, not {corners.shape}", key="path")
    most = np.where(scenario.robot.drive.is_rotation, np.radians(MOST_TURNS_DEG), np.finfo(np.float64).max)
    for row, j in np.argwhere(~(np.abs(corners) <= most)):
        joint, value = scenario.robot.drive.joints[j], float(corners[row, j])
        rule = f"from {-MOST_TURNS_DEG:g} to {MOST_TURNS_DEG:g} {joint.unit}" if np.isfinite(value) else "finite"
        where = f"row {row}: {joint.name} = {value / joint.si_per_unit:g} {joint.unit}"
        raise InputError(f"{where}: must be {rule}", file=scenario.path, key="path")
    scenario.robot.drive.warn_of_degrees("path", corners)
    _refuse_joints(scenario, "begin at the scenario's start", corners[0] - scenario.start)
    return corners


def _refuse_joints(scenario: Scenario, where: str, off: Array) -> None:
    """Raises InputError where joints are off (m,) by more than rounding."""
    if np.abs(off).max() > SAME_JOINTS:
        joint = scenario.robot.drive.joints[int(np.argmax(np.abs(off)))]
        away = f"{np.abs(off).max() / joint.si_per_unit:.4g} {joint.unit}"
        raise InputError(f"must {where}, but {joint.name} is {away} away", file=scenario.path, key="path")


def _stages(scenario: Scenario, corners: Array) -> list[Array]:
    """The path (K, m) from target to target. Raises InputError unless it passes all of them, and ends at the last.

    A target is passed by the frictionless tip, or by the middle of those that friction moves.
    """
    ways, begin, driven = list[Array](), 0, list[tuple[Array, Array]]()
    for goal in scenario.via:
        for k in range(begin, len(corners)):
            if not _miss(scenario, goal, corners[k]):
                break
            driven = driven or ([] if goal.joints is not None else _driven(scenario, corners))
            if goal.joints is None and not _off(scenario, goal, *driven[k]):
                break
        else:
            rule = f"must pass the targets in their order, but no waypoint is at {goal.place} after those before it"
            raise InputError(rule, file=scenario.path, key="path")
        ways.append(merge_legs(corners[begin : k + 1]))
        begin = k
    last, goal = corners[-1], scenario.goal
    if goal.joints is not None:
        _refuse_joints(scenario, "end at the scenario's goal", JointSpace.of(scenario).difference(goal.joints, last))
    elif (miss := _miss(scenario, goal, last)) and "direction" in miss:  # certificates judge the tip, friction included
        raise InputError(f"must end in the goal's direction: {miss}", file=scenario.path, key="path")
    return [*ways, merge_legs(corners[begin:])]


def _miss(scenario: Scenario, goal: Goal, joints: Array) -> str:
    """Why the frictionless robot at joints (m,) is not at a goal; empty where it is."""
    robot = scenario.robot
    if goal.joints is not None:
        off = np.abs(JointSpace.of(scenario).difference(goal.joints, joints)).max()
        return "" if off <= SAME_JOINTS else "other joint values"
    tips = robot.mechanics.tips_with_friction(*robot.drive.collars(joints[None]), np.zeros((1, robot.n - 1)))
    return _off(scenario, goal, tips.position_m[0], tips.tangent[0])


def _driven(scenario: Scenario, corners: Array) -> list[tuple[Array, Array]]:
    """Middles (3,) [m] and mean tangents (3,) of tips at each waypoint (K, m), from any friction before the path."""
    found = predict(scenario.robot, corners, start_states(scenario))
    tips = found.tip_m.transpose(1, 0, 2)  # (K, S, 3), NaN from where a history failed on
    middles = [ball_centre(rows) if np.isfinite(rows).all() else np.full(3, np.nan) for rows in tips]
    return list(zip(middles, found.tangent.mean(axis=0), strict=True))


def _off(scenario: Scenario, goal: Goal, tip_m: Array, tangent: Array) -> str:
    """Why a tip (3,), robot's frame, is not at a goal in space; empty where it is."""
    if goal.direction is not None and goal.direction_tolerance_rad is not None:
        angle = float(angle_to(tangent[None], scenario.base_R.T @ goal.direction)[0])
        if not angle <= goal.direction_tolerance_rad:
            most = f"{np.degrees(goal.direction_tolerance_rad):g}"
            return f"the tip is {np.degrees(angle):.3g} deg off that direction, tolerance {most} deg"
    off_m = float(np.linalg.norm(scenario.located(tip_m[None])[0] - goal.tip_m))
    return "" if off_m <= goal.tolerance_m else f"the tip is {off_m * MM_PER_M:.3g} mm from it"


def _along(scenario: Scenario, corners: Array, timing: Trajectory) -> Trajectory:
    """The trajectory, in arrays. Raises InputError for one of other joints or without a clock, or that leaves the path
    (K, m), a leg out, or its order.
    """
    names = scenario.robot.drive.names
    if timing.names != names:
        raise InputError(f"must drive {', '.join(names)}", file=scenario.path, key="timing")
    time_s, position = numbers(timing.time_s, "timing.time_s"), numbers(timing.position, "timing.position")
    if not time_s.size or position.shape != (time_s.size, len(names)):
        rule = f"must have times (T,) and joint values (T, {len(names)}), not {time_s.shape}, {position.shape}"
        raise InputError(rule, file=scenario.path, key="timing")
    for k in np.flatnonzero(~np.isfinite(np.column_stack([time_s, position])).all(axis=1)):
        raise InputError("must be finite", file=scenario.path, key=f"timing, sample {k + 1}")
    for k in np.flatnonzero(np.diff(time_s) <= 0):
        rule = f"must be later than the sample before, {time_s[k]:.9g} s"
        raise InputError(rule, file=scenario.path, key=f"timing.time_s, sample {k + 2}", value=time_s[k + 1], unit="s")
    places_on_legs(position, merge_legs(corners), scenario.path, "timing")
    return replace(timing, time_s=time_s, position=position)


def refuse_late_drive(scenario: Scenario) -> None:
    """Raises InputError for a robot whose collars follow unequally late: they leave the path of the joints."""
    late = scenario.robot.drive.joint_late_s
    if np.ptp(late) > 0:
        rule = f"joints follow up to {np.max(late):.3g} s late, not alike, and leave the path: give its timing"
        raise InputError(rule, file=scenario.robot.path, key="effects.drive_lag")
