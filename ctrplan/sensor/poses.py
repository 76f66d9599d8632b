"""The sensor's stage: rigid motions of poses, (K, 3) positions [m] and (K, 3, 3) frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Poses:
    """K poses of the sensor: position (K, 3) [m], frame (K, 3, 3) with columns x, y, tangent."""

    position: Array
    frame: Array


def rotation(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    matrix: Array = Rotation.from_rotvec(np.array(vector)).as_matrix()
    return matrix


def moved_rigidly(poses: Poses, turn: Array, shift: Array) -> Poses:
    """Poses turned about the origin of the robot's frame and then shifted; (3,) or one (K, 3) each."""
    R = rotation(np.broadcast_to(turn, poses.position.shape))
    return Poses(np.einsum("kij,kj->ki", R, poses.position) + shift, R @ poses.frame)


def frames_along(tangent: Array, across: Array) -> Array:
    """Frames (K, 3, 3) whose third axis is `tangent` (K, 3), the first as near to `across` (K, 3) as it can be."""
    first = across - np.sum(across * tangent, axis=1, keepdims=True) * tangent
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(tangent, first), tangent], axis=2)
