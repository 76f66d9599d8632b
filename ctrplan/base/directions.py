"""Directions (3,) of any length as unit vectors, and the rotations that take the z axis to them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array

Z = np.array([0.0, 0.0, 1.0])
TINY = 1e-12


def unit(vector: ArrayLike) -> Array:
    """A vector (3,), not zero, divided by its length; squares neither overflow nor vanish."""
    given = np.asarray(vector, dtype=np.float64)
    scaled = given / np.abs(given).max()
    return np.asarray(scaled / np.linalg.norm(scaled))


def shortest_rotation(direction: ArrayLike) -> Array:
    """(3, 3) the rotation by the smallest angle that takes z to a direction (3,); for -z about x."""
    aim = unit(direction)
    axis = np.cross(Z, aim)
    sine = float(np.linalg.norm(axis))
    if sine < TINY:
        return np.asarray(Rotation.from_rotvec([0.0 if aim[2] > 0 else math.pi, 0.0, 0.0]).as_matrix())
    return np.asarray(Rotation.from_rotvec(axis / sine * math.atan2(sine, aim[2])).as_matrix())
