"""How much of a clearance that is too small is anatomy, friction and allowances: the end of a refusal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.anatomy.parts import exact_clearance
from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M

if TYPE_CHECKING:
    from ctrplan.planning.motion import MotionChecker

TOO_CLOSE = "too close to the anatomy"  # how the sentences end that this is about


def shares_in_words(nominal_m: float, friction_m: float, allowed_m: float) -> str:
    """In brackets, with a space before them."""
    return (
        f" (the frictionless one is {nominal_m * MM_PER_M:.2f} mm beyond the margins, friction takes "
        f"{friction_m * MM_PER_M:.2f}, allowances {allowed_m * MM_PER_M:.2f})"
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
