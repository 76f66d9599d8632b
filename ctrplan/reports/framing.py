"""From where and how much of a scene pictures show."""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array

THINNEST_BOX = 0.35  # of its longest side, or the scene is hard to turn


def view_box(points_m: Array, anatomy_m: Array) -> tuple[Array, Array]:
    """Corners (3,), (3,) [m] of what to show: the robot's points (K, 3) and the anatomy (K, 3) around them."""
    lower, upper = points_m.min(axis=0), points_m.max(axis=0)
    around = 0.35 * float(np.linalg.norm(upper - lower)) + 5e-3
    if len(anatomy_m):
        lower = np.minimum(lower, np.maximum(anatomy_m.min(axis=0), lower - around))
        upper = np.maximum(upper, np.minimum(anatomy_m.max(axis=0), upper + around))
    extent = upper - lower
    rim = 0.03 * extent.max() + 1e-3 + np.maximum(THINNEST_BOX * extent.max() - extent, 0) / 2
    return lower - rim, upper + rim


def side_azimuth_rad(points_m: Array) -> float:
    """From where points (K, 3) spread widest to left and right; not along an axis, where a scene looks flat."""
    spread = np.cov((points_m - points_m.mean(axis=0))[:, :2].T)
    x, y = np.linalg.eigh(spread)[1][:, 0]
    quarter, rest = divmod(float(np.arctan2(y, x)), np.pi / 2)
    return float(np.pi / 2 * quarter + np.clip(rest, np.radians(25), np.radians(65)))
