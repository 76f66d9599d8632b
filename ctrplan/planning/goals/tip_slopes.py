"""Exact derivatives by the joints: of tips with friction, and of the bound."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.friction_law import corner_signs
from ctrplan.mechanics.shapes import Tips
from ctrplan.planning.motion import MotionChecker


def tips_by_joints(checker: MotionChecker, q: Array, phi: Array) -> Tips:
    """Tips at joint values q (K, m) in friction states phi (K, n - 1), with derivatives (K, 3, m) by rad or m.

    A joint at a limit of the tubes' nesting has no derivative and counts as fixed.
    """
    drive, n = checker.space.drive, checker.mechanics.n
    names = [f"theta_b.{i + 1}" for i in range(n)] + [f"l_b.{i + 1}" for i in range(n)]
    tips = checker.mechanics.tips_with_friction(*drive.collars(q), phi, parameters=names)
    moves = drive.collars_by_joints(q)
    by_joints = (np.nan_to_num(slope) @ moves for slope in (tips.position_by, tips.tangent_by))
    return replace(tips, position_by=next(by_joints), tangent_by=next(by_joints))


@dataclass(frozen=True, eq=False)
class BoundSlopes:
    """How the bound and the frictionless tip of K configurations change with the joints."""

    bound_by: Array  # (K, m) [m per rad or m] of the corner whose tip is farthest from the frictionless one
    tip_m: Array  # (K, 3) frictionless, robot's frame
    tip_by: Array  # (K, 3, m)


def bound_slopes(checker: MotionChecker, q: Array) -> BoundSlopes:
    """Derivatives of the bound on the tip's position at q (K, m), zero where a solve failed."""
    pairs = checker.mechanics.n - 1
    states = np.vstack([np.zeros(pairs), corner_signs(pairs)])
    tips = tips_by_joints(checker, np.repeat(q, len(states), axis=0), np.tile(states, (len(q), 1)))
    checker.meter.add(checker.solved_ns * len(q))
    position = tips.position_m.reshape(len(q), len(states), 3)
    by = tips.position_by.reshape(len(q), len(states), 3, -1)
    away = np.nan_to_num(position[:, 1:] - position[:, :1])
    size = np.linalg.norm(away, axis=2)
    rows, farthest = np.arange(len(q)), np.argmax(size, axis=1)
    unit = away[rows, farthest] / np.maximum(size[rows, farthest], 1e-12)[:, None]
    bound_by = np.einsum("ki,kij->kj", unit, by[rows, 1 + farthest] - by[:, 0])
    return BoundSlopes(bound_by, position[:, 0], by[:, 0])
