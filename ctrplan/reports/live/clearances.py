"""Clearances of a pose as the live view tells them: without friction, and of a grid of friction states."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.friction_states import POINT_SPACING_M, UNEVEN_FRICTION_M, mesh_allowance_m
from ctrplan.motion.play import play_reach

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

STATES = {1: 9}  # of each pair, by the number of pairs; of more pairs the extremes and the middle
FEWEST = 3


@dataclass(frozen=True)
class PoseClearances:
    """Exact distances beyond the margins [m]."""

    nominal_m: float
    friction_m: float
    sure_m: float  # the same less what a certificate takes off for the mesh, uneven friction and play


def pose_clearances(scenario: Scenario, joints: Array) -> PoseClearances | None:
    """At joints (m,); None in free space, or where the frictionless robot has no equilibrium."""
    distance, robot = AnatomyDistance.of(scenario), scenario.robot
    if distance is None:
        return None
    pairs = robot.n - 1 if robot.friction.any() else 0
    grid = np.linspace(-1, 1, STATES.get(pairs, FEWEST))
    rest = np.zeros((1, robot.n - 1))
    states = np.vstack([rest, list(itertools.product(grid, repeat=pairs))]) if pairs else rest
    theta_b, l_b = robot.drive.collars(joints)
    found = robot.mechanics.friction_bodies(theta_b, l_b, states, spacing_m=POINT_SPACING_M, accuracy="certificate")
    if not found.solved[0]:
        return None
    bodies = found.point_m[found.solved]
    owner = np.repeat(np.arange(len(bodies)), bodies.shape[1])
    least = distance.least(bodies.reshape(-1, 3), np.tile(found.radius_m, len(bodies)), owner, len(bodies))
    allowance = mesh_allowance_m(robot, "certificate") + UNEVEN_FRICTION_M + play_reach(robot, theta_b, l_b)
    return PoseClearances(float(least[0]), float(least.min()), float(least.min()) - allowance)


def clearances_mm(scenario: Scenario, joints: Array) -> dict[str, float | None]:
    """[mm] without friction, of the worst friction state, and that less allowances; None in free space."""
    found = pose_clearances(scenario, joints)
    if found is None:
        return dict.fromkeys(("nominal_mm", "friction_mm", "sure_mm"))
    return {
        "nominal_mm": found.nominal_m * 1e3,
        "friction_mm": found.friction_m * 1e3,
        "sure_mm": found.sure_m * 1e3,
    }
