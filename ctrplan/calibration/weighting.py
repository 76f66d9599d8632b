"""How positions and tangents are weighed: by the stated noise, or as in the paper."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ctrplan.calibration.residuals import Noise
from ctrplan.errors import InputError
from ctrplan.experiment.measurements import Measurements
from ctrplan.robot.robot import Robot

Weighting = Literal["stated", "paper"]

PAPER = Noise(1e-3, float(np.radians(1.0)))  # 1 deg of the tangent weighs as much as 1 mm, text at (49)
NO_TANGENT_SIGMA = "is missing, needed for the tangents of these measurements"


def weighed_by(robot: Robot, data: Measurements, weighting: Weighting | None) -> Noise:
    """The noise that residuals are divided by, the paper's where none is stated. Raises InputError if it must be."""
    stated = robot.measurement
    if weighting == "stated" and stated is None:
        raise InputError("is missing, needed for weights from the stated noise", file=robot.path, key="measurement")
    if stated is None or weighting == "paper":
        return PAPER
    if stated.tangent_sigma_rad is None and data.has_tangents:
        raise InputError(NO_TANGENT_SIGMA, file=robot.path, key="measurement.tangent_sigma_deg")
    return Noise(stated.position_sigma_m, stated.tangent_sigma_rad or PAPER.tangent_rad)
