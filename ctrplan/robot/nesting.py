"""Sentences about robots whose tubes do not nest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError
from ctrplan.mechanics.nesting import TOLERANCE_M, least_distance_m, nesting_inequalities

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot


def nesting_violation(robot: Robot, theta_b: ArrayLike, l_b: ArrayLike) -> str | None:
    """Sentence about the first nesting rule that collar coordinates (n,) [rad], (n,) [m] violate; None if they nest.

    Raises InputError for arrays of another shape. Rotations never violate nesting.
    """
    l = numbers(l_b, "l_b")  # noqa: E741
    for key, shape in (("theta_b", np.shape(theta_b)), ("l_b", l.shape)):
        if shape != (robot.n,):
            raise InputError(f"must have one value per tube, shape ({robot.n},), not {shape}", key=key)
    G, h = nesting_inequalities(robot.tubes)
    broken = np.flatnonzero(~(G @ l <= h + TOLERANCE_M))
    return _sentence(robot, int(broken[0]), l) if broken.size else None


def never_nests(robot: Robot) -> str | None:
    """Sentence about a nesting rule that no joint values within limits satisfy, if one is found."""
    G, h = nesting_inequalities(robot.tubes)
    drive, moved = robot.drive, ~robot.drive.is_rotation
    slope = (G @ drive.matrix_l)[:, moved]
    at_lower, at_upper = slope * drive.lower[moved], slope * drive.upper[moved]
    least = G @ drive.home_l_m + np.minimum(at_lower, at_upper).sum(axis=1)
    broken = np.flatnonzero(least > h + TOLERANCE_M)
    return _sentence(robot, int(broken[0]), drive.home_l_m) if broken.size else None


def _sentence(robot: Robot, row: int, l_b: Array) -> str:
    """What is wrong in row `row` of the inequalities at base translations `l_b`."""
    if row == 0:
        return f"{_base(robot, 0, l_b)} must be at or behind the plate, l_1b <= 0"
    i = (row - 1) % (robot.n - 1)
    outer, inner = robot.tubes[i], robot.tubes[i + 1]
    bases = f"{_base(robot, i + 1, l_b)} and {_base(robot, i, l_b)}"
    if row < robot.n:
        apart_m = least_distance_m(outer, inner)
        is_collar = apart_m == inner.collar_length_m
        needed = f"the collar of tube {i + 2}" if is_collar else f"room for the compliant shaft of tube {i + 1}"
        return f"{bases} must be at least {apart_m * 1e3:.6g} mm apart, {needed}"
    ends = [f"{(l + tube.length_m) * 1e3:.6g} mm" for l, tube in zip(l_b[i : i + 2], (outer, inner), strict=True)]  # noqa: E741
    return f"{bases} must keep the tips in order, but tube {i + 2} ends at {ends[1]} and tube {i + 1} at {ends[0]}"


def _base(robot: Robot, i: int, l_b: Array) -> str:
    """The base of tube i (from 0), the joints that translate it, and where it is."""
    movers = [joint.name for joint, moves in zip(robot.drive.joints, robot.drive.matrix_l[i], strict=True) if moves]
    moved_by = f" (moved by {', '.join(movers)})" if movers else ""
    return f"the base of tube {i + 1}{moved_by} at l_{i + 1}b = {l_b[i] * 1e3:.6g} mm"
