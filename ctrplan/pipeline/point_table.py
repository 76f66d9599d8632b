"""Poses of the points that were measured: tips, and markers on the body.

Tips come with exact derivatives. The core differentiates no other points: markers are points of whole shapes, and
`ParametricChain` differences them.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.cores import cores
from ctrplan.drive.collars import Collars
from ctrplan.experiment.measurements import Measurements
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.mechanics.nesting import is_in_order
from ctrplan.mechanics.points_on_tubes import points_on_tubes
from ctrplan.mechanics.shapes import Shape, Status
from ctrplan.pipeline.tip_table import NESTED_M, TipTable, distinct, nested, tip_table
from ctrplan.robot.robot import Robot


def on_body(robot: Robot, data: Measurements) -> NDArray[np.bool_]:
    """(K,) poses of markers that are not the robot's tip itself."""
    elsewhere = np.array([False, *(not marker.is_tip(robot.n) for marker in robot.markers)])
    found: NDArray[np.bool_] = elsewhere[data.seen_marker]
    return found


def markers_on(robot: Robot, shape: Shape, l_b: Array) -> tuple[Array, Array]:
    """(M, 3) [m] and unit tangents (M, 3) of the robot's markers on a shape with collars at l_b (n,) [m]."""
    return points_on_tubes(
        [shape.tubes[marker.tube - 1] for marker in robot.markers], _places_m(robot) + _bases(robot, l_b)
    )


def _places_m(robot: Robot) -> Array:
    """(M,) arc lengths [m] of the markers from the bases of their tubes."""
    return np.array([marker.along_m(robot.tubes[marker.tube - 1].length_m) for marker in robot.markers])


def _bases(robot: Robot, l_b: Array) -> Array:
    """(M,) [m] where the bases of the markers' tubes are, with collars at l_b (n,) [m]."""
    return l_b[[marker.tube - 1 for marker in robot.markers]]


def point_table(
    robot: Robot,
    data: Measurements,
    collars: Collars,
    phi: Array,
    names: Sequence[str] = (),
    accuracy: Accuracy = "search",
) -> TipTable:
    """The measured points at collars (K, n), in friction states (K, n - 1); derivatives of tips only, else zero."""
    body = on_body(robot, data)
    tips = tip_table(robot, collars.theta[~body], collars.l[~body], phi[~body], names, accuracy)
    if not body.any():
        return tips
    found = TipTable(
        np.empty((data.count, 3)), np.empty((data.count, 3)), *np.zeros((2, data.count), bool),
        *np.zeros((2, data.count, 3, len(names))),
    )  # fmt: skip
    markers = _marker_table(robot, data.seen_marker[body], collars.theta[body], collars.l[body], phi[body], accuracy)
    for name in TipTable.__dataclass_fields__:
        getattr(found, name)[~body] = getattr(tips, name)
        if not name.endswith("by"):
            getattr(found, name)[body] = getattr(markers, name)
    return found


def _marker_table(
    robot: Robot, marker: NDArray[np.int_], theta_b: Array, l_b: Array, phi: Array, accuracy: Accuracy
) -> TipTable:
    """Markers (K,) by number; a shape serves all that were seen on it."""
    inside = nested(robot, l_b)
    first, back = distinct(np.hstack([theta_b, inside, phi]))
    shapes = _shapes(robot, theta_b[first], inside[first], phi[first], accuracy)
    failed = np.array([shape.status == Status.FAILED for shape in shapes])[back]
    sound = ~failed & np.array([shape.status != Status.UNSTABLE for shape in shapes])[back]
    tube = np.array([given.tube - 1 for given in robot.markers])[marker - 1]
    tubes = [shapes[k].tubes[i] for k, i in zip(back.tolist(), tube.tolist(), strict=True)]
    at = inside[np.arange(len(marker)), tube] + _places_m(robot)[marker - 1]
    position, tangent = points_on_tubes(tubes, at)
    lost = ~np.isfinite(position).all(axis=1)
    position[lost], tangent[lost] = 0.0, [0.0, 0.0, 1.0]
    return TipTable(position, tangent, sound & ~lost & is_in_order(robot.tubes, l_b, NESTED_M), failed | lost, *_no(2))


def _shapes(robot: Robot, theta_b: Array, l_b: Array, phi: Array, accuracy: Accuracy) -> list[Shape]:
    """Of D configurations, on every core: the core solves without Python's lock."""
    solve = partial(robot.mechanics.solve, accuracy=accuracy)
    with ThreadPoolExecutor(min(cores(), len(theta_b))) as pool:
        return list(pool.map(solve, theta_b, l_b, phi))


def _no(count: int) -> Array:
    return np.zeros((count, 0, 3, 0))
