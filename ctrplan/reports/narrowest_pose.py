"""The robot where friction brings it closest to the anatomy on a plan's way, with the clearance along its body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.anatomy.parts import exact_clearance
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Rod

if TYPE_CHECKING:
    from ctrplan.planning.certified import Closest
    from ctrplan.planning.scenario import Scenario

SPACING_M = 1e-3
NUDGE_M = 1e-5  # of differences of the distance


@dataclass(frozen=True, eq=False)
class NarrowestPose:
    """In the friction state that comes closest; anatomy's frame."""

    place: Closest
    body: Rod  # outline of N stations
    clearance_m: Array  # (N,) of its surface beyond the margins
    gap_m: Array  # (2, 3) from the tube's surface to the anatomy's


def narrowest_pose(scenario: Scenario, place: Closest | None) -> NarrowestPose | None:
    """Solves one shape; None in free space, where there is no such place, and where the model has no solution."""
    if place is None:
        return None
    collars = scenario.robot.drive.collars(place.joints)
    found = scenario.robot.mechanics.friction_bodies(
        *collars, place.phi[None], spacing_m=SPACING_M, accuracy="certificate"
    )
    if not found.solved[0] or len(found.radius_m) < 2:
        return None
    points = scenario.located(found.point_m[0])
    along = np.gradient(points, axis=0)
    tangent = along / np.linalg.norm(along, axis=1, keepdims=True)
    clearance = exact_clearance(scenario.anatomy, points) - found.radius_m
    return NarrowestPose(place, Rod(points, tangent, found.radius_m), clearance, _gap(scenario, place))


def _gap(scenario: Scenario, place: Closest) -> Array:
    """(2, 3) straight across the free room at a place."""
    steps = NUDGE_M * np.concatenate([np.eye(3), -np.eye(3)])
    ahead, behind = exact_clearance(scenario.anatomy, place.point_m + steps).reshape(2, 3)
    away = (ahead - behind) / max(float(np.linalg.norm(ahead - behind)), 1e-12)
    radius = scenario.robot.tubes[place.tube - 1].outer_diameter_m / 2
    return place.point_m - np.array([[radius], [radius + place.distance_m]]) * away
