"""Whether the start of a motion has another equilibrium, which some turn before it leads to.

Nobody knows what the robot did before a plan. Corners of friction are solved from the frictionless shape. Where a
corner has a second equilibrium, far from it, an approach may end there and break the bound. Approaches are simulated:
all pairs turned by APPROACH_DEG at once, from either side each, which loads friction fully.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import SolverError
from ctrplan.planning.certificate.allowances import BEYOND_BOUND_M
from ctrplan.robot.robot import Robot

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

APPROACH_DEG = 90.0  # of Section V of Ha et al. 2019

_KNOWN: WeakKeyDictionary[Robot, dict[bytes, str]] = WeakKeyDictionary()


def other_start(scenario: Scenario, joints: Array) -> str:
    """A sentence about an approach to joints (m,) that ends beyond the bound there; empty if none does.

    Where the scenario says what friction is like at its start, no approach comes before it. What an observer found says
    nothing for the bound, which is that of every friction state.
    """
    robot = scenario.robot
    if scenario.start_friction in ("released", "oscillated"):
        return ""
    known = _KNOWN.setdefault(robot, {})
    key = joints.tobytes()
    if key not in known:
        known[key] = _other_start(robot, joints)
    return known[key]


def _other_start(robot: Robot, joints: Array) -> str:
    theta_b, l_b = robot.drive.collars(joints)
    bound = robot.mechanics.bound(theta_b, l_b)
    if robot.n == 1 or not robot.friction.any() or not np.isfinite(bound.position_m):
        return ""

    def beyond(turns: Array) -> float:
        from_side = theta_b - np.concatenate([[0.0], np.cumsum(turns)])
        try:
            path = robot.history().follow(np.array([from_side, theta_b]), np.array([l_b, l_b]))
        except SolverError:  # there is no equilibrium to come from
            return 0.0
        away = float(np.linalg.norm(path.position_m[-1] - bound.frictionless.tip_m))
        return float(np.nan_to_num(away - bound.position_m))

    approaches = list(_approaches(robot.n - 1))
    with ThreadPoolExecutor() as pool:
        found = list(pool.map(beyond, approaches))
    worst = int(np.argmax(found))
    if found[worst] <= BEYOND_BOUND_M:
        return ""
    turned = ", ".join(f"{np.degrees(turn):+.0f}" for turn in approaches[worst])
    away_mm = (found[worst] + bound.position_m) * MM_PER_M
    return (
        f"The start has another equilibrium: approached by relative turns of ({turned}) deg the tip stands "
        f"{away_mm:.1f} mm from the frictionless one, beyond the bound of {bound.position_m * MM_PER_M:.2f} mm"
    )


def _approaches(pairs: int) -> Iterator[Array]:
    """(P,) relative turns [rad] that end at the configuration, of all pairs."""
    for signs in itertools.product((1.0, -1.0), repeat=pairs):
        yield np.radians(APPROACH_DEG) * np.array(signs)
