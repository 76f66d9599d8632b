"""Bounds as a certificate states them: with the mesh's allowance, the largest solved on the certificate mesh.

Samples have the bounds of the mesh that they were walked on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.planning.certificate.allowances import bound_allowance_m
from ctrplan.robot.robot import Robot

MOST = 20  # samples solved on the certificate mesh


@dataclass(frozen=True)
class StatedBounds:
    """Worst-case errors of the tip [m]."""

    goal_m: float
    worst_m: float


def stated_bounds(robot: Robot, joints: Array, bound_m: Array, accuracies: Sequence[Accuracy]) -> StatedBounds:
    """At the last and over all samples: joints (K, m), bounds (K,) of walks, the mesh of each."""
    upper = bound_m + [bound_allowance_m(robot, accuracy) for accuracy in accuracies]
    goal = _closely(robot, joints[-1], bound_m[-1], upper[-1])
    upper[-1] = goal
    for _ in range(MOST):
        k = int(np.argmax(upper))
        closely = _closely(robot, joints[k], bound_m[k], upper[k])
        if not closely < upper[k]:
            break
        upper[k] = closely
    return StatedBounds(goal, float(upper.max()))


def _closely(robot: Robot, joints: Array, walked_m: float, upper_m: float) -> float:
    """The bound on the certificate mesh with its allowance, where it is the same equilibrium; never above `upper_m`."""
    found = robot.mechanics.bound(*robot.drive.collars(joints), accuracy="certificate").position_m
    closely = found + bound_allowance_m(robot, "certificate")
    is_same = walked_m - bound_allowance_m(robot, "search") <= closely <= upper_m
    return float(closely if is_same else upper_m)
