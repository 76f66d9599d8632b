"""Frames of the innermost tube at the tip, which a sensor that is fixed to it turns with.

They take a whole shape for every pose, hardly move during a fit, and a diagnosis makes hundreds of fits to the same
poses: frames found for another one serve as long as tips point to within 1 deg where they did, and collars as well.
With a sensor 3 mm off the tube's axis that is 0.05 mm. What is remembered goes with the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ctrplan.base.arrays import Array, read_only
from ctrplan.drive.collars import Collars
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.tip_table import nested
from ctrplan.robot.robot import Robot

NEAR_RAD, NEAR_M, NEAR_STATE = np.radians(1.0), 0.3e-3, 0.1  # that tangents, collars, friction states may have moved
MOST = 4  # of the same poses, elsewhere


@dataclass(frozen=True, eq=False)
class _Found:
    tangent: Array  # (K, 3)
    collars: Collars
    phi: Array  # (K, n - 1)
    x: Array  # (K, 3)

    def serves(self, collars: Collars, phi: Array, tangent: Array) -> bool:
        """Whether nothing has moved far."""
        return bool(
            np.abs(self.tangent - tangent).max(initial=0.0) <= NEAR_RAD
            and np.abs(self.collars.theta - collars.theta).max(initial=0.0) <= NEAR_RAD
            and np.abs(self.collars.l - collars.l).max(initial=0.0) <= NEAR_M
            and np.abs(self.phi - phi).max(initial=0.0) <= NEAR_STATE
        )


_FOUND: WeakKeyDictionary[Measurements, list[_Found]] = WeakKeyDictionary()


def remembered_tip_x(data: Measurements, robot: Robot, collars: Collars, phi: Array, tangent: Array) -> Array:
    """(K, 3) x axes of K poses in friction states (K, n - 1), whose tangents are (K, 3)."""
    known = _FOUND.setdefault(data, [])
    for found in known:
        if found.serves(collars, phi, tangent):
            return found.x
    rows = zip(collars.theta, nested(robot, collars.l), phi, strict=True)
    x = read_only(np.array([robot.solve(*row).tubes[-1].frames[-1, :, 0] for row in rows]))
    known.insert(0, _Found(tangent, collars, phi, x))
    del known[MOST:]
    return x
