"""A scenario's anatomy as a grid of clearances, built once for a robot's place."""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from ctrplan.anatomy.anatomy_field import anatomy_field, shared_spacing_m
from ctrplan.anatomy.clearance_grid import SignedDistanceField, field_bounds

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

MOST_GRIDS = 4  # kept in memory for one robot, of different bases or anatomies
_GRIDS: WeakKeyDictionary[Robot, dict[bytes, SignedDistanceField]] = WeakKeyDictionary()


def anatomy_grid(scenario: Scenario) -> SignedDistanceField | None:
    """The scenario's anatomy as a signed-distance field around the robot's reach, built once; None in free space."""
    if not scenario.anatomy:
        return None
    grids = _GRIDS.setdefault(scenario.robot, {})
    place = np.append(scenario.base_R.ravel(), scenario.base_position_m)
    key = (
        place.tobytes() + np.array([id(part) for part in scenario.anatomy]).tobytes()
    )  # the grid keeps its parts alive
    if key not in grids:
        reach = max(tube.length_m for tube in scenario.robot.tubes) + scenario.robot.tubes[0].outer_diameter_m
        lower, upper = field_bounds(scenario.anatomy, reach, scenario.base_position_m, scenario.base_R)
        while len(grids) >= MOST_GRIDS:
            del grids[next(iter(grids))]
        grids[key] = anatomy_field(
            scenario.anatomy,
            lower,
            upper,
            shared_spacing_m(scenario.anatomy, reach),
            base_position_m=scenario.base_position_m,
            reach_m=reach,
        )
    return grids[key]
