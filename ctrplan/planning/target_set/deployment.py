"""Stability on the way from a scenario's start to a configuration: rotations first, then translations."""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity
from ctrplan.planning.motion import MotionChecker

DENSITY = PathDensity(rotation_rad=0.5, translation_m=12e-3, motion_m=25e-3)


def least_stability(checker: MotionChecker, joints: Array) -> float:
    """Of the states along the L-shaped motion from the start to joints (m,); at most 0 where the robot snaps there."""
    corners = checker.space.corners(checker.scenario.start, joints, checker.style)
    if not checker.space.allowed(corners):
        return 0.0
    samples = checker.mechanics.check_path(*checker.space.drive.collars(corners), None, density=DENSITY)
    least = float(np.nanmin(samples.stability))
    return least if samples.status[-1] == Status.CONVERGED else min(least, 0.0)
