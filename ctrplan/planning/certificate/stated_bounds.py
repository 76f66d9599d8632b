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
    found = robot.mechanics.bound_many(*robot.drive.collars(joints), accuracy="certificate").position_m
    closely = found + bound_allowance_m(robot, "certificate")
    is_same = (walked_m - bound_allowance_m(robot, "search") <= closely) & (closely <= upper_m)
    return np.where(is_same, closely, upper_m)
