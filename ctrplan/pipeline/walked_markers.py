"""A history along a path with the robot's markers on the way."""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.history import History, HistoryPath
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.point_table import markers_on
from ctrplan.robot.robot import Robot


def walked(robot: Robot, history: History, theta_b: Array, l_b: Array) -> tuple[HistoryPath, Array]:
    """The history along collars (K, n) [rad], (K, n) [m], and (K, M, 6) position [m] and tangent of M markers.

    NaN after a waypoint without an equilibrium. Without markers it is one call into the core.
    """
    markers = np.full((len(theta_b), len(robot.markers), 6), np.nan)
    if not robot.markers:
        return history.follow(theta_b, l_b), markers
    steps = []
    for k in range(len(theta_b)):
        steps.append(history.follow(theta_b[k : k + 1], l_b[k : k + 1]))
        if steps[-1].status[0] < Status.FAILED:
            markers[k] = np.hstack(markers_on(robot, history.shape(), l_b[k]))
    names = HistoryPath.__dataclass_fields__
    return HistoryPath(*(np.concatenate([getattr(step, name) for step in steps]) for name in names)), markers
