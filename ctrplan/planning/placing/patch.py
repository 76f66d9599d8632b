"""Base poses to try: positions on a patch or along an opening, directions in a cone about the way to the targets."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.base.directions import shortest_rotation, unit
from ctrplan.base.units import MM_PER_M

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Goal

DIGITS, MM_DIGITS = 12, 6  # of a quaternion and of mm in files
# A Kronecker sequence: numbers whose multiples, modulo 1, fill the cube of six dimensions evenly. They are powers of
# the inverse of the root of x^7 = x + 1, the golden ratio's like in six dimensions.
STEPS = 1.1127756842787055 ** -np.arange(1.0, 7.0)


@dataclass(frozen=True, eq=False)
class Pose:
    """The robot's frame in the anatomy's."""

    position_m: Array  # (3,)
    R: Array  # (3, 3)

    @property
    def direction(self) -> Array:
        """(3,) of the z axis, along which the tubes leave the plate."""
        return np.asarray(self.R[:, 2])

    @property
    def quaternion_wxyz(self) -> Array:
        """(4,) of norm 1, w not negative."""
        return np.roll(Rotation.from_matrix(self.R).as_quat(canonical=True), 1)

    def into_robot(self, points_m: Array) -> Array:
        """Points (..., 3) of the anatomy's frame in the robot's."""
        return np.asarray((points_m - self.position_m) @ self.R)


@dataclass(frozen=True, eq=False)
class Patch:
    """A disc across the way to the targets, or what it sweeps along an opening, and a cone of directions."""

    center_m: Array  # (3,)
    along_m: Array | None  # (3,) the other end of an opening
    radius_m: float
    cone_rad: float
    aim_m: Array  # (3,) the middle of the targets, or another place to look at
    upright: Array  # (3, 3) base rotation from which others are the shortest turn
    rolls: bool  # whether tubes can't all turn together, so that it matters how the base is rolled

    def poses(self, seed: int) -> Iterator[Pose]:
        """Endless, spread evenly, the same for the same seed."""
        shift = np.random.default_rng(seed).random(len(STEPS))
        for k in count():
            yield self._pose(*np.mod(shift + k * STEPS, 1.0).tolist())

    def _pose(self, out: float, around: float, tilt: float, side: float, along: float, roll: float) -> Pose:
        """From six numbers in [0, 1): place on the disc, direction in the cone, place along the opening, roll."""
        position = self.center_m.copy()
        if self.along_m is not None:
            position += along * (self.along_m - self.center_m)
        across = shortest_rotation(_way(self.aim_m - position, self.upright))[:, :2]
        position += self.radius_m * math.sqrt(out) * across @ _on_circle(around)
        cosine = 1 - tilt * (1 - math.cos(self.cone_rad))  # all directions of the cone alike
        leaning = np.append(math.sqrt(max(0.0, 1 - cosine**2)) * _on_circle(side), cosine)
        way = shortest_rotation(_way(self.aim_m - position, self.upright))
        turned = looking(self.upright, way @ leaning)
        if self.rolls:
            turned = turned @ Rotation.from_euler("z", 2 * math.pi * roll).as_matrix()
        return as_written(Pose(position, turned))


def as_written(pose: Pose) -> Pose:
    """The pose in as many digits as a file is given, so that reading it back gives the same."""
    quaternion = np.roll(np.round(pose.quaternion_wxyz, DIGITS), -1)
    position_mm = np.round(pose.position_m * MM_PER_M, MM_DIGITS)
    return Pose(np.multiply(position_mm, 1e-3), np.asarray(Rotation.from_quat(quaternion).as_matrix()))


def looking(upright: Array, direction: Array) -> Array:
    """(3, 3) the base rotation `upright` after the shortest turn of its z axis to a direction (3,)."""
    return np.asarray(upright @ shortest_rotation(upright.T @ direction))


def middle_of(targets: Sequence[Goal]) -> Array:
    """(3,) [m] of their tips."""
    return np.asarray(np.mean([goal.tip_m for goal in targets if goal.tip_m is not None], axis=0))


def _way(away: Array, upright: Array) -> Array:
    """(3,) unit vector; where there is no way to go, the base's own axis."""
    return unit(away) if np.any(away) else np.asarray(upright[:, 2])


def _on_circle(share: float) -> Array:
    return np.array([math.cos(2 * math.pi * share), math.sin(2 * math.pi * share)])
