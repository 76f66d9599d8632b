"""From where pictures of a motion are taken.

It is seen from its side, from its plate, at its target, and from inside along its path.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from ctrplan.base.arrays import Array, Z
from ctrplan.base.surface import rod_vertices
from ctrplan.reports.looks import side_azimuth_rad
from ctrplan.reports.plan_scene import TILT, WrittenMotion
from ctrplan.reports.render.rasteriser import Camera
from ctrplan.reports.robot_surface import RobotPose

View = Literal["side", "plate", "target", "inside"]
VIEWS: tuple[str, ...] = get_args(View)
HALF_VIEW = float(np.tan(np.radians(14)))
WIDE = float(np.tan(np.radians(48)))  # of an endoscope
LAMP_M, NEAR_M = 45e-3, 0.4e-3
TARGET_SHARE, TARGET_M = 0.22, 12e-3  # of the robot's length around the target, and at least


def look_at(eye_m: Array, at_m: Array, up: Array, half_view: float, near_m: float = 1e-3) -> Camera:
    """A camera that has a point in its middle; `up` may lean, and is replaced where it is the line of sight."""
    return Camera(eye_m, view_axes(at_m - eye_m, up), half_view, near_m)


def view_axes(toward: Array, up: Array) -> Array:
    """(3, 3) rows right, up, forward of a view."""
    forward = toward / np.linalg.norm(toward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def looking_along(toward: Array, up: Array, points_m: Array, half_view: float, aspect: float) -> Camera:
    """A camera so far back that all points (K, 3) are seen, in a picture `aspect` times as wide as high."""
    axes = view_axes(toward, up)
    placed = points_m @ axes.T
    (low_x, low_y, _), (high_x, high_y, _) = placed.min(axis=0), placed.max(axis=0)
    middle = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2])
    off = np.abs(placed[:, :2] - middle) / [half_view * aspect, half_view]
    back = float((placed[:, 2] - off.max(axis=1)).min())
    near = max(1e-3, 0.2 * float(placed[:, 2].min() - back))
    return Camera(np.array([*middle, back]) @ axes, axes, half_view, near)


def camera_of(view: View, motion: WrittenMotion, aspect: float) -> Callable[[RobotPose], Camera]:
    """The camera at each pose; one that stands still is the same object for all of them."""
    if view == "inside":
        return _endoscope(motion)
    camera = {"side": _from_side, "plate": _from_plate, "target": _at_target}[view](motion, aspect)
    return lambda pose: camera


def robot_points(motion: WrittenMotion) -> Array:
    """(K, 3) all that the robot's envelope takes, plate included."""
    rods = rod_vertices([pose.envelope for pose in motion.path], 6)
    return np.concatenate([*rods, motion.scenario.base_position_m[None]])


def _from_side(motion: WrittenMotion, aspect: float) -> Camera:
    points = robot_points(motion)
    return looking_along(-_sideways(points), Z, _roomy(points), HALF_VIEW, aspect)


def _from_plate(motion: WrittenMotion, aspect: float) -> Camera:
    """Over the shoulder of whoever stands at the drive: along the robot's axis, from above."""
    points, axis = robot_points(motion), motion.scenario.base_R[:, 2]
    side = _sideways(points)
    toward = axis - 0.45 * (side - (side @ axis) * axis)
    return looking_along(toward, side, _roomy(points), HALF_VIEW, aspect)


def _at_target(motion: WrittenMotion, aspect: float) -> Camera:
    points, goal = robot_points(motion), motion.path[-1].tip_m
    toward = -_sideways(points)
    length = float(np.linalg.norm(goal - motion.scenario.base_position_m))
    seen_m = max(TARGET_SHARE * length, TARGET_M)
    eye = goal - toward * seen_m / HALF_VIEW
    return look_at(eye, goal, Z, HALF_VIEW, near_m=0.3 * seen_m / HALF_VIEW)


def _endoscope(motion: WrittenMotion) -> Callable[[RobotPose], Camera]:
    """At the tip, looking where it points; up is carried along without twist."""
    ups: dict[float, Array] = {}
    up = Z
    for pose in motion.path:
        axes = view_axes(pose.tubes[-1].tangent[-1], up)
        up = ups[pose.time_s] = axes[1]

    def camera(pose: RobotPose) -> Camera:
        rod = pose.tubes[-1]
        return Camera(rod.centreline_m[-1], view_axes(rod.tangent[-1], ups[pose.time_s]), WIDE, NEAR_M, LAMP_M)

    return camera


def _sideways(points: Array) -> Array:
    """(3,) to the eye: from where the robot spreads widest, a little from above."""
    azimuth = side_azimuth_rad(points)
    return np.array([np.cos(TILT) * np.cos(azimuth), np.cos(TILT) * np.sin(azimuth), np.sin(TILT)])


def _roomy(points: Array) -> Array:
    """Points with a rim around them."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    roomy: Array = middle + 1.12 * (points - middle)
    return roomy
