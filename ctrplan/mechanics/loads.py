"""External loads on a robot: dead forces in the world frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ctrplan.errors import InputError

Vector = tuple[float, float, float]

ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Loads:
    """Force [N] and moment [N m] on the innermost tip, and the acceleration [m/s^2] that gives every tube its weight.

    Vectors of three in the world frame, z along insertion. The front plate bears what reaches tube 1.
    """

    tip_force_N: Vector = ZERO
    tip_moment_Nm: Vector = ZERO
    gravity_m_s2: Vector = ZERO

    def __post_init__(self) -> None:
        """Raises InputError unless each is three finite numbers."""
        for entry in fields(self):
            vector = getattr(self, entry.name)
            try:
                sound = len(vector) == 3 and all(map(math.isfinite, vector))
            except TypeError:
                sound = False
            if not sound:
                raise InputError("must be three finite numbers", key=entry.name, value=vector)
