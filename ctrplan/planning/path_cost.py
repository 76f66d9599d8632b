"""What a path costs, weighed in one place: search, certificate, reordering and benchmarks mean the same by it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ctrplan.base.units import MM_PER_M

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Cost


def path_cost_mm(weights: Cost, *, length_mm: float, legs: int, integral_mm: float, left_m: float) -> float:
    """Cost [mm] of `length_mm` of joint length driven in `legs` legs, the drive stopping after each.

    integral_mm: of the released error along the path, see `MotionChecker.price`; left_m: bound and released error at
    every target that is reached, summed.
    """
    cost = weights.path * length_mm + weights.error_along * integral_mm + weights.stop * legs
    return cost + weights.error_goal * left_m * MM_PER_M
