"""The sensor's stage: poses of the tip, markers along the body, and the noise of a tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ctrplan.base.arguments import Choice, Number, Whole, checked
from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Poses:
    """K poses of the sensor: position (K, 3) [m], frame (K, 3, 3) with columns x, y, tangent."""

    position: Array
    frame: Array


def rotation(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    from scipy.spatial.transform import Rotation  # slow to import

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


@checked(
    tube=Whole(1, 1000),
    distance_m=Number(0, 10, "m"),
    end=Choice("tip", "base"),
    position_sigma_m=Number(1e-9, 1, "m"),
)
@dataclass(frozen=True)
class Marker:
    """A marker around a tube, its middle on the tube's centreline, at an arc length from one of the tube's ends."""

    name: str
    tube: int  # from 1, outermost first
    distance_m: float  # along the tube, from its tip or its base
    end: Literal["tip", "base"] = "tip"
    position_sigma_m: float | None = None  # noise of each coordinate; None: that of the tip

    def along_m(self, length_m: float) -> float:
        """Arc length [m] from the base of a tube of this length; a marker stays at its distance if lengths change."""
        return length_m - self.distance_m if self.end == "tip" else self.distance_m

    def is_tip(self, tubes: int) -> bool:
        """Whether it is the tip of the innermost of so many tubes itself."""
        return self.tube == tubes and self.end == "tip" and self.distance_m == 0

    @property
    def columns(self) -> tuple[str, str, str]:
        """Names of its columns in measurements and tables."""
        return f"{self.name}_x_m", f"{self.name}_y_m", f"{self.name}_z_m"


@checked(position_sigma_m=Number(1e-9, 1, "m"), tangent_sigma_rad=Number(1e-8, 3.2, "rad"))
@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of each coordinate of the tip and of a small rotation of its tangent about each axis.

    A tracker of positions alone has no second one.
    """

    position_sigma_m: float
    tangent_sigma_rad: float | None = None
