"""Tips of many configurations with clearance and friction, and their derivatives by named parameters and joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.mechanics.loads import Loads
from ctrplan.mechanics.nesting import is_in_order, moved_to_nest
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import Tube
from ctrplan.robot.robot import Robot

NESTED_M = 1e-8  # collars and tips out of order by less do not matter
SAME = 1e-12  # configurations that differ by less are solved once
MOST_REMEMBERED = 12  # tables: fits ask again where the one before them ended, a quarter of all a diagnosis asks


@dataclass(frozen=True, eq=False)
class TipTable:
    """K tips; derivatives for P names."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    sound: NDArray[np.bool_]  # (K,) whether the solve converged on an equilibrium
    failed: NDArray[np.bool_]  # (K,) whether it did not converge at all: the tip is that of the last iterate
    position_by: Array  # (K, 3, P)
    tangent_by: Array  # (K, 3, P)


def tip_table(
    robot: Robot, theta_b: Array, l_b: Array, phi: Array, names: Sequence[str] = (), accuracy: Accuracy = "search"
) -> TipTable:
    """Tips at (K, n) [rad], (K, n) [m] in friction states (K, n - 1); names as in `parameters`, or theta_b.1, l_b.1."""
    inside = nested(robot, l_b)
    sound = is_in_order(robot.tubes, l_b, NESTED_M)
    phi = phi * _rubbing(robot, names)
    rows = np.hstack([theta_b, inside, phi])
    first, back = distinct(rows)
    table = _solved(_Asked.of(robot, rows[first], names, accuracy))
    found = TipTable(*(getattr(table, key)[back] for key in TipTable.__dataclass_fields__))
    return replace(found, sound=found.sound & sound)


def distinct(rows: Array) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Of rows (K, c): the numbers (D,) of those that differ, and which of them each is (K,)."""
    _, first, back = np.unique(np.round(rows / SAME) * SAME, axis=0, return_index=True, return_inverse=True)
    return first, back.ravel()


def _rubbing(robot: Robot, names: Sequence[str]) -> NDArray[np.bool_]:
    """(n - 1,) pairs whose friction state matters: those with friction, or whose friction is differentiated by."""
    asked = [f"contact.{i}.friction_coefficient" in names for i in range(1, robot.n)]
    rubbing: NDArray[np.bool_] = (robot.friction[:, 1] > 0) | np.array(asked, dtype=bool)
    return rubbing


def nested(robot: Robot, l_b: Array) -> Array:
    """Base translations (K, n) with those that do not nest moved to where they do."""
    return moved_to_nest(robot.tubes, l_b)


@dataclass(frozen=True)
class _Asked:
    """What decides on a table: the numbers of the mechanics, and rows (D, 3 n - 1) of collars and friction states."""

    tubes: tuple[Tube, ...]
    loads: Loads
    pairs: bytes
    rows: bytes
    names: tuple[str, ...]
    accuracy: Accuracy
    robot: Robot = field(compare=False)

    @classmethod
    def of(cls, robot: Robot, rows: Array, names: Sequence[str], accuracy: Accuracy) -> _Asked:
        pairs = np.hstack([robot.clearance_m, robot.friction[:, 1]]).tobytes()
        return cls(robot.tubes, robot.loads, pairs, rows.tobytes(), tuple(names), accuracy, robot)


@lru_cache(MOST_REMEMBERED)
def _solved(asked: _Asked) -> TipTable:
    n = asked.robot.n
    theta_b, l_b, phi = np.split(np.frombuffer(asked.rows).reshape(-1, 3 * n - 1), [n, 2 * n], axis=1)
    tips = asked.robot.mechanics.tips_with_friction(theta_b, l_b, phi, parameters=asked.names, accuracy=asked.accuracy)
    failed = tips.status == Status.FAILED
    sound = ~failed & (tips.status != Status.UNSTABLE)
    by = np.nan_to_num(tips.position_by), np.nan_to_num(tips.tangent_by)  # NaN where a joint can't be moved by itself
    return TipTable(tips.position_m, tips.tangent, sound, failed, *by)
