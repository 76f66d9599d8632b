"""How the friction bound at a target changes with the robot itself, the tip being led back onto the target.

The core differentiates tips by the numbers of the robot and by its collars, exactly; what the numbers owe to a
parameter of the design is arithmetic, differenced between two robots. With J the derivatives of the frictionless tip
and b those of the bound, by joints q and parameters p, weighted by the joints' lengths:

    db/dp at rest = b_p - b_q J_q^+ J_p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.planning.goals.goal_descent import RANK
from ctrplan.planning.motion import MotionChecker
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot
from ctrplan.uncertain.tip_slopes import friction_states


@dataclass(frozen=True, eq=False)
class RobotPair:
    """A robot with one parameter of its design a little smaller and a little larger than it is."""

    name: str
    low: Robot
    high: Robot


def bound_by(checker: MotionChecker, joints: Array, pairs: Sequence[RobotPair]) -> Array:
    """(P,) [m] by which the bound at joints (m,) grows for half the difference of each pair, to first order.

    A number that can't be moved by itself there, because tubes end at the same place, counts as fixed.
    """
    robot = checker.scenario.robot
    names, numbers_by = _numbers(robot, pairs)
    moved_by = _collars(checker, joints, pairs)
    collars = [f"{kind}.{i + 1}" for kind in ("theta_b", "l_b") for i in range(robot.n)]
    states = friction_states(robot)
    rows = np.repeat(joints[None], len(states), axis=0)
    found = checker.mechanics.tips_with_friction(
        *checker.space.drive.collars(rows), states, parameters=[*names, *collars]
    )
    by = np.nan_to_num(found.position_by)
    by_parameters = by[..., : len(names)] @ numbers_by + by[..., len(names) :] @ moved_by
    by_joints = by[..., len(names) :] @ checker.space.drive.collars_by_joints(joints[None])[0]
    away = np.nan_to_num(found.position_m[1:] - found.position_m[0])
    size = np.linalg.norm(away, axis=1)
    k = int(np.argmax(size)) if len(size) else 0
    if not len(size) or size[k] == 0:
        return np.zeros(len(pairs))
    unit, weights = away[k] / size[k], checker.space.weights_mm / MM_PER_M
    direct, led = (unit @ (part[1 + k] - part[0]) for part in (by_parameters, by_joints))
    back = np.linalg.pinv(by_joints[0] / weights, RANK) @ by_parameters[0]
    slopes: Array = direct - (led / weights) @ back
    return slopes


def robot_at(robot: Robot, pairs: Sequence[RobotPair], share: Array) -> Robot:
    """The robot with its numbers moved by shares (P,) of half the difference of each pair; the drive stays."""
    names, by = _numbers(robot, pairs)
    moved = (value_of(robot, name) + float(step) for name, step in zip(names, by @ share, strict=True))
    return with_values(robot, dict(zip(names, moved, strict=True)))


def _numbers(robot: Robot, pairs: Sequence[RobotPair]) -> tuple[list[str], Array]:
    """Names of the numbers (N,) in which any pair differs, and half of those differences (N, P) [SI]."""
    names = _all_names(robot)
    half = [[(value_of(p.high, name) - value_of(p.low, name)) / 2 for p in pairs] for name in names]
    by = np.array(half).reshape(len(names), len(pairs))
    used = np.flatnonzero(by.any(axis=1)).tolist()
    return [names[k] for k in used], by[used]


def _all_names(robot: Robot) -> list[str]:
    """What a tip can be differentiated by that a design may change."""
    found = []
    for i, tube in enumerate(robot.tubes, start=1):
        found += [f"tube.{i}.bending_stiffness_Nm2", f"tube.{i}.poisson_ratio"]
        for k in range(1, len(tube.sections) + 1):
            found += [f"tube.{i}.section.{k}.{key}" for key in ("length_m", "curvature_x_per_m", "curvature_y_per_m")]
    for i in range(1, robot.n):
        found += [f"contact.{i}.clearance_m", f"contact.{i}.friction_coefficient"]
    return found


def _collars(checker: MotionChecker, joints: Array, pairs: Sequence[RobotPair]) -> Array:
    """(2 n, P) half of what collars differ by at joints (m,)."""
    columns = [
        (np.concatenate(p.high.drive.collars(joints)) - np.concatenate(p.low.drive.collars(joints))) / 2 for p in pairs
    ]
    return np.array(columns).reshape(len(pairs), 2 * checker.mechanics.n).T
