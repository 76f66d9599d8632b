"""The friction bound of a robot whose parameters are known by intervals: `bound_with_parameters`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import Made, checked
from ctrplan.base.arrays import Array
from ctrplan.mechanics.core_arrays import joint_rows
from ctrplan.robot.robot import Robot
from ctrplan.uncertain.parameters import UncertainParameters, uncertain_parameters
from ctrplan.uncertain.tip_slopes import TipSlopes, tip_slopes, tips_at
from ctrplan.uncertain.worst_case import OffsetBox, farthest


@dataclass(frozen=True, eq=False)
class UncertainBounds:
    """Largest distance of the tip from where the file's robot has it without friction, at K configurations."""

    position_m: Array  # (K,) over every corner of friction and every parameter in its interval; inf without a solution
    friction_m: Array  # (K,) over the corners alone
    beyond_first_order_m: Array  # (K,) by how much the solved extreme differs from the linear one; in position_m


@checked(robot=Made("Robot"))
def bound_with_parameters(robot: Robot, theta_commanded: ArrayLike, l_commanded: ArrayLike) -> UncertainBounds:
    """Worst-case tip deviations with the 95 % intervals of the robot's file, (n,) or (K, n) [rad] and [m] commanded.

    First order in the parameters by exact derivatives; the worst combination of each configuration is solved, and what
    it differs by is added. Without intervals the same as `robot.bound_many`.
    """
    theta, l = joint_rows(np.atleast_2d(theta_commanded), np.atleast_2d(l_commanded), robot.n)  # noqa: E741
    parameters = uncertain_parameters(robot)
    slopes = tip_slopes(parameters, theta, l)
    friction = friction_bound_m(slopes)
    if not parameters.count:
        return UncertainBounds(friction, friction, np.zeros(len(friction)))
    worst, beyond = worst_bound_m(parameters, slopes, theta, l)
    return UncertainBounds(np.where(np.isnan(worst), np.inf, worst + beyond), friction, beyond)


def friction_bound_m(slopes: TipSlopes) -> Array:
    """(K,) over the corners; inf where one has no solution."""
    away = np.linalg.norm(slopes.tip_m - slopes.tip_m[:, :1], axis=2).max(axis=1)
    return np.where(np.isnan(away), np.inf, away)


def worst_bound_m(
    parameters: UncertainParameters,
    slopes: TipSlopes,
    theta: Array,
    l: Array,  # noqa: E741 (as in the equations)
) -> tuple[Array, Array]:
    """(K,) [m] to first order, and by how much the worst combination of parameters, solved, is off that."""
    box, (count, states) = OffsetBox.of(parameters), slopes.tip_m.shape[:2]
    away = slopes.tip_m - slopes.tip_m[:, :1]
    lost = np.isnan(away).any(axis=(1, 2)) | np.isnan(slopes.by).any(axis=(1, 2, 3))
    by = np.nan_to_num(slopes.by).reshape(-1, 3, parameters.count)
    found = farthest(np.nan_to_num(away).reshape(-1, 3), box.displaced(by))
    length = found.length_m.reshape(count, states)
    state, rows = np.argmax(length, axis=1), np.arange(count)
    beyond = np.zeros(count)
    for k in rows.tolist():
        offset = box.middle + box.axes @ found.signs.reshape(count, states, -1)[k, state[k]]
        tip = tips_at(parameters, offset, theta[k : k + 1], l[k : k + 1])[0, state[k]]
        linear = slopes.tip_m[k, state[k]] + slopes.by[k, state[k]] @ offset
        beyond[k] = np.nan_to_num(np.linalg.norm(tip - linear), nan=np.inf)
    return np.where(lost, np.nan, length[rows, state]), beyond
