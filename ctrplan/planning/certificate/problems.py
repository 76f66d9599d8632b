"""Why walked legs must not be certified, in sentences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.mechanics.walk import PathLimits
from ctrplan.planning.certificate.allowances import SAME_BRANCH_M, SPACING_M, mesh_allowance_m
from ctrplan.planning.certificate.goal_miss import line_error_m
from ctrplan.planning.certificate.stated_bounds import StatedBounds
from ctrplan.planning.certificate.walked_piece import Piece
from ctrplan.planning.certified import CertificateSamples
from ctrplan.planning.clearance_shares import shares_in_words
from ctrplan.planning.joint_space import JointSpace
from ctrplan.planning.motion import breach, path_limits

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

BRANCH_TOLERANCE_M = 0.2e-3  # between tips of a shape at the ends of neighbouring pieces, reached on two ways
LEAP_M = 2 * SPACING_M  # a shape that moves farther between samples was not followed


def problems_of_walk(scenario: Scenario, space: JointSpace, corners: Array, pieces: Sequence[Piece]) -> list[str]:
    """What keeps shapes from being followed along the polyline `corners` (K, m)."""
    found = []
    if not space.allowed(corners):
        found.append("A waypoint breaks a joint limit or the nesting of the tubes.")
    for before, piece in zip([None, *pieces[:-1]], pieces, strict=True):
        where = f"leg {piece.leg + 1}"
        if piece.samples.fraction[-1] < 1 and len(pieces) > 1 or breach(piece.samples, PathLimits()):
            found.append(f"On {where}: {breach(piece.samples, PathLimits()) or 'the walk did not reach its end'}.")
        elif before is not None and _apart(scenario, before, piece) > BRANCH_TOLERANCE_M:
            found.append(f"On {where}: the shape depends on the way there, several equilibria exist.")
        if piece.apart_m > SAME_BRANCH_M:
            found.append(f"On {where}: another equilibrium exists for the same joints and friction.")
        if (leap := float(piece.samples.motion_m.max())) > LEAP_M:
            found.append(
                f"On {where}: a shape leaps by {leap * MM_PER_M:.1f} mm, its friction state loses its equilibrium."
            )
        if (low := float((piece.height_m - piece.offset_m(scenario, piece.accuracy)).min())) < 0:
            found.append(
                f"On {where}: a shape curls back to the front plate, {-low * MM_PER_M:.1f} mm too near or through it."
            )
    return found


def problems_of_limits(
    scenario: Scenario, pieces: Sequence[Piece], samples: CertificateSamples, bounds: Callable[[], StatedBounds]
) -> list[str]:
    """Which of the scenario's limits the samples of the pieces break; `bounds` are asked for where one is on them."""
    limits = path_limits(scenario)
    shares = _shares_of_clearance(scenario, pieces, limits)
    if taken_m := float(samples.parameter_clearance_m[int(np.argmin(samples.clearance_m))]):
        opening = shares.removesuffix(")") + "," if shares else " (of which"
        shares = f"{opening} uncertain parameters and registration {taken_m * MM_PER_M:.2f})"
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
    found = [
        f"On leg {samples.leg[np.argmax(broken)] + 1}: {text.format(value)}."
        for broken, text, value in checks
        if broken.any()
    ]
    return found + _problems_of_goal(scenario, samples, bounds)


def _taken(by_parameters: Array, sample: int) -> str:
    taken = float(by_parameters[sample])
    return f" (of which uncertain parameters {taken:.3g})" if taken else ""


def _problems_of_goal(scenario: Scenario, samples: CertificateSamples, bounds: Callable[[], StatedBounds]) -> list[str]:
    found, limit, on_line = [], scenario.cost.max_error_goal_m, line_error_m(scenario, samples.tip_m)
    if limit is not None:
        error_m, where = (bounds().goal_m, "at the goal") if on_line is None else (bounds().worst_m, "on the line")
        if not error_m <= limit:
            error_mm, limit_mm = error_m * MM_PER_M, limit * MM_PER_M
            found.append(f"The worst-case error {where} is {error_mm:.2f} mm, above {limit_mm:g} mm.")
    if on_line is not None and not on_line <= scenario.goal.tolerance_m:
        off_mm, tolerance_mm = on_line * MM_PER_M, scenario.goal.tolerance_m * MM_PER_M
        found.append(f"The frictionless tip leaves the line by {off_mm:.2f} mm, tolerance {tolerance_mm:g} mm.")
    return found


def _shares_of_clearance(scenario: Scenario, pieces: Sequence[Piece], limits: PathLimits) -> str:
    """How much anatomy, friction and allowances make up the least clearance, as the end of a sentence."""
    piece = min(pieces, key=lambda one: float(one.clearance_m.min()))
    k = int(np.argmin(piece.clearance_m))
    nominal, least = float(piece.nominal_m[k]), float(piece.clearance_m[k])
    if not np.isfinite(nominal) or not np.isfinite(least):
        return ""
    offset = float(piece.offset_m(scenario, "certificate")[k])
    friction, allowed = max(0.0, nominal - least - offset), offset + limits.clearance_m
    return shares_in_words(nominal, friction, allowed)


def _apart(scenario: Scenario, before: Piece, after: Piece) -> float:
    """Largest distance [m] of tips of one shape, frictionless or corner, where two pieces meet.

    Less what their meshes may differ by.
    """
    ends = [np.vstack([s.tip_m[k], *s.corner_tip_m[k][:, None]]) for s, k in ((before.samples, -1), (after.samples, 0))]
    gap = float(np.linalg.norm(ends[0] - ends[1], axis=1).max())
    return gap if before.accuracy == after.accuracy else gap - mesh_allowance_m(scenario.robot, "search")
