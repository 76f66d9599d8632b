"""From where a picture is taken: a pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye, an orthonormal frame and how much is seen; anatomy's frame, m."""

    eye_m: Array  # (3,)
    axes: Array  # (3, 3) rows: to the right, up, forward
    half_view: float  # tangent of half the angle from the middle to the top of the picture
    near_m: float = 1e-3  # what is nearer is not seen
    lamp_m: float = np.inf  # how far its own light reaches; infinite where the scene is lit from elsewhere

    def seen(self, points_m: Array) -> Array:
        """Points (..., 3) in the camera's frame: right, up, forward [m]."""
        found: Array = (points_m - self.eye_m) @ self.axes.T
        return found


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
