"""Why walked legs must not be certified, in sentences; bounds and distances from the goal as a certificate states
them.

Samples have the bounds of the mesh that they were walked on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.anatomy.parts import exact_clearance
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.certificate.certificate import CertificateSamples
from ctrplan.certificate.friction_states import bound_allowance_m, mesh_allowance_m
from ctrplan.certificate.other_equilibria import way_to_unwind
from ctrplan.certificate.walked_piece import LEAP_M, Piece
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.mechanics.equilibria import SAME_SHAPE_M
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.mechanics.walk import PathLimits
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.limits import TOO_CLOSE, breach, path_limits
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.tip_solver import target_in_robot_frame

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario


def goal_miss_m(scenario: Scenario, tip: Array) -> float:
    """[m] of a tip (3,), robot's frame, from the goal's; 0 for joint goals."""
    if scenario.goal.tip_m is None:
        return 0.0
    return float(np.linalg.norm(tip - target_in_robot_frame(scenario)))


def line_error_m(scenario: Scenario, tip_m: Array) -> float | None:
    """Largest distance of tips (K, 3), robot's frame, from the goal's line; None without a line."""
    if scenario.goal.line_m is None:
        return None
    located = scenario.located(tip_m)
    return float(distance_from_polyline(located, scenario.goal.line_m).max())


def frictionless_miss(scenario: Scenario, tip_m: Array) -> list[str]:
    """Sentences if the last of tips (K, 3) misses the goal, or any of them its line."""
    goal, miss, on_line = scenario.goal, goal_miss_m(scenario, tip_m[-1]), line_error_m(scenario, tip_m)
    result, allowed = [], f"tolerance {goal.tolerance_m * MM_PER_M:g} mm"
    if on_line is not None and not on_line <= goal.tolerance_m:
        result.append(f"The frictionless tip leaves the line by {on_line * MM_PER_M:.2f} mm, {allowed}.")
    if goal.tip_m is not None and not miss <= goal.tolerance_m:
        result.append(f"The frictionless tip ends {miss * MM_PER_M:.2f} mm from the target, {allowed}.")
    return result


MOST = 20  # samples solved on the certificate mesh


@dataclass(frozen=True)
class StatedBounds:
    """Worst-case errors of the tip [m]."""

    goal_m: float
    worst_m: float


def stated_bounds(robot: Robot, joints: Array, bound_m: Array, accuracies: Sequence[Accuracy]) -> StatedBounds:
    """At the last and over all samples: joints (K, m), bounds (K,) of walks, the mesh of each."""
    upper = bound_m + [bound_allowance_m(robot, accuracy) for accuracy in accuracies]
    last, known = len(upper) - 1, dict[int, float]()

    def closely(k: int) -> float:
        if k not in known:  # with the one that is likely asked for next, on the other core
            other = max((j for j in range(len(upper)) if j != k and j not in known), key=lambda j: upper[j], default=k)
            rows = list(dict.fromkeys([k, other]))
            known.update(zip(rows, _closely(robot, joints[rows], bound_m[rows], upper[rows]).tolist(), strict=True))
        return known[k]

    upper[last] = goal = closely(last)
    for _ in range(MOST):
        k = int(np.argmax(upper))
        if not closely(k) < upper[k]:
            break
        upper[k] = closely(k)
    return StatedBounds(goal, float(upper.max()))


def _closely(robot: Robot, joints: Array, walked_m: Array, upper_m: Array) -> Array:
    """(K,) bounds on the certificate mesh with its allowance, where it is the same equilibrium; else `upper_m`."""
    result = robot.mechanics.bound_many(*robot.drive.collars(joints), accuracy="certificate").position_m
    closely = result + bound_allowance_m(robot, "certificate")
    is_same = (walked_m - bound_allowance_m(robot, "search") <= closely) & (closely <= upper_m)
    return np.where(is_same, closely, upper_m)


BRANCH_TOLERANCE_M = 0.2e-3  # between tips of a shape at the ends of neighbouring pieces, reached on two ways
# In sentences where the shape that is followed is not the one that is solved at the joints by themselves.
PARTED = ("the shape depends on the way there", "another equilibrium exists for the same joints and friction.")


def problems_of_walk(scenario: Scenario, space: JointSpace, corners: Array, pieces: Sequence[Piece]) -> list[str]:
    """What keeps shapes from being followed along the polyline `corners` (K, m)."""
    results = []
    if not space.allowed(corners):
        results.append("A waypoint breaks a joint limit or the nesting of the tubes.")
    if (guide := scenario.robot.guide) is not None:
        allowed_m = SAME_SHAPE_M if pieces[0].accuracy == "search" else mesh_allowance_m(scenario.robot, "search")
        here = guide.near(pieces[0].theta_b[0], pieces[0].l_b[0])
        if not np.linalg.norm(pieces[0].samples.tip_m[0] - here.tip_m[0]) <= allowed_m:
            results.append("At the start: the stable shape that the robot stands in is not solved again.")
    for before, piece in zip([None, *pieces[:-1]], pieces, strict=True):
        where = f"leg {piece.leg + 1}"
        if piece.samples.fraction[-1] < 1 and len(pieces) > 1 or breach(piece.samples, PathLimits()):
            results.append(f"On {where}: {breach(piece.samples, PathLimits()) or 'the walk did not reach its end'}.")
        elif piece.walks.fault:
            results.append(f"On {where}: {piece.walks.fault}.")
        elif before is not None and apart_m(scenario, before, piece) > BRANCH_TOLERANCE_M:
            walked_m, own_m = (tips[: 2**piece.pairs + 1] for tips in (before.end_tips_m[1], piece.end_tips_m[0]))
            unwinding = way_to_unwind(scenario.robot, piece.joints[0], walked_m, own_m)
            end = f": the robot may be wound up there; {unwinding}" if unwinding else ""
            results.append(f"On {where}: {PARTED[0]}, several equilibria exist{end}.")
        if piece.apart_m > SAME_SHAPE_M:
            results.append(f"On {where}: {PARTED[1]}")
        if (leap := float(piece.motion_m.max())) > LEAP_M:
            results.append(
                f"On {where}: a shape leaps by {leap * MM_PER_M:.1f} mm, its friction state loses its equilibrium."
            )
        kept_m = piece.offset_m(scenario, piece.accuracy) + scenario.robot.model_error_m
        if (low := float((piece.height_m - kept_m).min())) < 0:
            results.append(
                f"On {where}: a shape curls back to the front plate, {-low * MM_PER_M:.1f} mm too near or through it."
            )
    return results


def problems_of_limits(
    scenario: Scenario, pieces: Sequence[Piece], samples: CertificateSamples, bounds: Callable[[], StatedBounds]
) -> list[str]:
    """Sentences on limits of the scenario that the samples break; `bounds` are computed where a limit is on them."""
    limits = path_limits(scenario)
    shares = _shares_of_clearance(scenario, pieces, limits)
    softer = _taken(samples.parameter_stability, int(np.argmin(samples.stability)))
    strained = _taken(samples.parameter_strain, int(np.argmax(samples.max_strain)))
    checks = [
        (
            samples.stability < limits.stability,
            f"stability falls to {{:.3g}}, below the margin{softer}",
            samples.stability.min(),
        ),
        (
            samples.max_strain > limits.max_strain,
            f"strain reaches {{:.4g}}, above the limit{strained}",
            samples.max_strain.max(),
        ),
        (
            samples.clearance_m < limits.clearance_m,
            f"a shape that friction allows comes {{:.2f}} mm too close to the anatomy{shares}",
            (limits.clearance_m - samples.clearance_m.min()) * MM_PER_M,
        ),
    ]
    results = [
        f"On leg {samples.leg[np.argmax(broken)] + 1}: {text.format(value)}."
        for broken, text, value in checks
        if broken.any()
    ]
    return results + _problems_of_goal(scenario, samples, bounds)


def _taken(by_parameters: Array, sample: int) -> str:
    taken = float(by_parameters[sample])
    return f" (of which intervals and play {taken:.3g})" if taken else ""


def _problems_of_goal(scenario: Scenario, samples: CertificateSamples, bounds: Callable[[], StatedBounds]) -> list[str]:
    result, limit, on_line = [], scenario.cost.max_error_goal_m, line_error_m(scenario, samples.tip_m)
    if limit is not None:
        error_m, where = (bounds().goal_m, "at the goal") if on_line is None else (bounds().worst_m, "on the line")
        if not error_m <= limit:
            error_mm, limit_mm = error_m * MM_PER_M, limit * MM_PER_M
            result.append(f"The worst-case error {where} is {error_mm:.2f} mm, above {limit_mm:g} mm.")
    return result


def _shares_of_clearance(scenario: Scenario, pieces: Sequence[Piece], limits: PathLimits) -> str:
    """How much anatomy, friction and allowances make up the least clearance, as the end of a sentence."""
    piece = min(pieces, key=lambda piece: float(piece.clearance_m.min()))
    k = int(np.argmin(piece.clearance_m))
    nominal, least = float(piece.nominal_m[k]), float(piece.clearance_m[k])
    if not np.isfinite(nominal) or not np.isfinite(least):
        return ""
    offset = float(piece.offset_m(scenario, "certificate")[k])
    taken = float(piece.taken_m[k])
    friction, allowed = max(0.0, nominal - least - offset - taken), offset + limits.clearance_m
    return shares_in_words(nominal, friction, allowed, taken)


def apart_m(scenario: Scenario, before: Piece, after: Piece) -> float:
    """Largest distance [m] of tips of one shape, frictionless or corner, where two pieces meet.

    Less what their meshes may differ by.
    """
    pairs = zip(before.end_tips_m[1], after.end_tips_m[0], strict=False)  # where a walk failed there are fewer
    gap = max(float(np.linalg.norm(a - b)) for a, b in pairs)
    return gap if before.accuracy == after.accuracy else gap - mesh_allowance_m(scenario.robot, "search")


def shares_in_words(nominal_m: float, friction_m: float, allowed_m: float, stated_m: float = 0.0) -> str:
    """In brackets, with a space before them; stated_m is what intervals, play and registration take."""
    stated = f", intervals, play and registration {stated_m * MM_PER_M:.2f}" if stated_m else ""
    return (
        f" (the frictionless one is {nominal_m * MM_PER_M:.2f} mm beyond the margins, friction takes "
        f"{friction_m * MM_PER_M:.2f}{stated}, allowances {allowed_m * MM_PER_M:.2f})"
    )


def with_shares(checker: MotionChecker, joints: Array, reason: str, clearance_m: float) -> str:
    """`reason` with the shares where it is about clearance, `clearance_m` being that of all shapes at joints (m,)."""
    nominal_m = _frictionless_clearance(checker, joints) if reason.endswith(TOO_CLOSE) else np.nan
    if not np.isfinite(nominal_m):
        return reason
    return reason + shares_in_words(nominal_m, max(0.0, nominal_m - clearance_m), checker.limits.clearance_m)


def _frictionless_clearance(checker: MotionChecker, joints: Array) -> float:
    """[m] beyond the margins; not a number where the model has no solution."""
    scenario = checker.scenario
    robot = scenario.robot
    bodies = robot.mechanics.friction_bodies(*robot.drive.collars(joints), np.zeros((1, robot.n - 1)))
    if not bodies.solved[0]:
        return float("nan")
    located = scenario.located(bodies.point_m[0])
    return float((exact_clearance(scenario.anatomy, located) - bodies.radius_m).min(initial=np.inf))
