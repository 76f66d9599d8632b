"""What the tubes do to the front plate: the moment of curved sections that it holds straight.

In front of the plate the tubes balance each other. Behind it they are guided straight: each curved section there bears
on the guide with its stiffness times its precurvature. Across the guide's length that is a mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.tube import Tube

GUIDE_M = 10e-3  # of the plate, behind its front


def plate_moment(tubes: Sequence[Tube], theta_b: Array, l_b: Array) -> Array:
    """(K, 2) [N m] about x and y on the guide, with collars at (K, n) [rad] and (K, n) [m]; zero of straight tubes."""
    moment = np.zeros((len(theta_b), 2))
    for i, tube in enumerate(tubes):
        cosine, sine = np.cos(theta_b[:, i]), np.sin(theta_b[:, i])
        begin = l_b[:, i]
        for section in tube.sections:
            end = begin + section.length_m
            inside = np.clip(np.minimum(end, 0.0) - np.maximum(begin, -GUIDE_M), 0.0, None) / GUIDE_M
            size = tube.bending_stiffness_Nm2 * inside
            x, y = section.curvature_x_per_m, section.curvature_y_per_m
            moment += size[:, None] * np.column_stack([cosine * x - sine * y, sine * x + cosine * y])
            begin = end
    return moment


def largest_plate_moment(tubes: Sequence[Tube]) -> float:
    """[N m] that no configuration exceeds."""
    return sum(t.bending_stiffness_Nm2 * max(section.curvature_per_m for section in t.sections) for t in tubes)
