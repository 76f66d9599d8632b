"""The noise of the measurement: as the robot file states it, or from repeats. Never assumed.

Repeats are poses of one configuration that were approached alike: the model says the same of them, whatever it lacks.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise
from ctrplan.errors import InputError
from ctrplan.experiment.friction_states import friction_state, last_directions
from ctrplan.experiment.measurements import Measurements
from ctrplan.robot.robot import Robot

LEAST_SPARE = 20  # repeats beyond the first of their kind: the noise is then known to about 10 %
FAR = 4.5  # times the typical distance of a repeat from its mean, beyond which one says nothing about noise
SAME_STATE = 1e-3


def noise_floor(robot: Robot, data: Measurements) -> tuple[Noise, str]:
    """Noise, and a sentence about it if it is from repeats. Raises InputError where neither file nor data have it."""
    if robot.measurement is not None:
        return Noise(robot.measurement.position_sigma_m, robot.measurement.tangent_sigma_rad), ""
    kind = repeats(data)
    spare = len(kind) - len(np.unique(kind))
    if data.is_stream or spare < LEAST_SPARE:
        have = "a continuous motion has none" if data.is_stream else f"these data have {spare}"
        rule = (
            "is missing: state position_sigma_mm and tangent_sigma_deg, or measure at least "
            f"{LEAST_SPARE} poses again, approached the same way ({have})"
        )
        raise InputError(rule, file=robot.path, key="measurement")
    found = Noise(spread(data.position_m, kind, 3), spread(data.tangent, kind, 2))
    sentence = (
        f"The robot file states no noise; {spare} repeated poses say {found.position_m * 1e3:.3g} mm and "
        f"{math.degrees(found.tangent_rad):.3g} deg."
    )
    return found, sentence


def repeats(data: Measurements) -> NDArray[np.int_]:
    """(K,) number that poses share which have configuration, last directions and friction state in common."""
    states = np.round(friction_state(data) / SAME_STATE).astype(np.int64)
    marks = np.column_stack([data.configuration, last_directions(data).astype(np.int64), states])
    return np.unique(marks, axis=0, return_inverse=True)[1].ravel()


def spread(vectors: Array, kind: NDArray[np.int_], axes: int) -> float:
    """Standard deviation of each of `axes` coordinates of vectors (K, 3) within kinds (K,); far ones are left out."""
    count: Array = np.bincount(kind).astype(np.float64)
    used = count[kind] > 1
    while True:
        count = np.asarray(np.bincount(kind, weights=used), dtype=np.float64)
        means = np.stack([np.bincount(kind, weights=used * column) for column in vectors.T], axis=1)
        away = vectors - (means / np.maximum(count, 1)[:, None])[kind]
        share = np.maximum(1 - 1 / np.maximum(count, 1), 0.5)[kind]  # of the variance, the rest is the mean's
        distance = np.linalg.norm(away, axis=1) / np.sqrt(share)
        far = used & (distance > FAR * np.median(distance[used]))
        if not far.any():
            spare = float(np.sum(np.maximum(count - 1, 0)))
            return float(np.sqrt(np.sum(away[used] ** 2) / (axes * spare)))
        used &= ~far
