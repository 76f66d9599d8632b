"""The anatomy's clearance wherever the robot reaches from any pose of a patch: one grid, seen from each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.anatomy.anatomy_field import anatomy_field, shared_spacing_m
from ctrplan.anatomy.clearance_grid import field_bounds
from ctrplan.anatomy.distance_field import SignedDistanceField
from ctrplan.base.arrays import Array
from ctrplan.mechanics.walk import Field
from ctrplan.planning.placing.patch import Patch, Pose

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


def patch_field(scenario: Scenario, patch: Patch) -> SignedDistanceField | None:
    """None in free space. Bricks that are on disk for other poses of the robot are taken from there."""
    if not scenario.anatomy:
        return None
    reach = max(tube.length_m for tube in scenario.robot.tubes) + scenario.robot.tubes[0].outer_diameter_m
    ends = [patch.center_m, *([] if patch.along_m is None else [patch.along_m])]
    middle = np.mean(ends, axis=0)
    far = reach + patch.radius_m + max(float(np.linalg.norm(end - middle)) for end in ends)
    lower, upper = _around(scenario, middle, far)
    return anatomy_field(
        scenario.anatomy,
        lower,
        upper,
        shared_spacing_m(scenario.anatomy, reach),
        base_position_m=middle,
        reach_m=far,
    )


def _around(scenario: Scenario, middle_m: Array, far_m: float) -> tuple[Array, Array]:
    """Corners (3,), (3,) of what lies in front of a base in the middle or behind it."""
    halves = [field_bounds(scenario.anatomy, far_m, middle_m, np.diag([1.0, side, side])) for side in (1.0, -1.0)]
    return np.min([lower for lower, _ in halves], axis=0), np.max([upper for _, upper in halves], axis=0)


def seen_from(grid: SignedDistanceField, pose: Pose) -> Field:
    """The grid as the core takes it for a robot at a pose."""
    return Field(grid.values_m, grid.origin_m, float(grid.spacing_m), pose.R, pose.position_m)
