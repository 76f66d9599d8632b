"""How exactly a tracker measures."""

from __future__ import annotations

from dataclasses import dataclass

from ctrplan.base.arguments import Number, checked


@checked(position_sigma_m=Number(1e-9, 1, "m"), tangent_sigma_rad=Number(1e-8, 3.2, "rad"))
@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of each coordinate of the tip and of a small rotation of its tangent about each axis.

    A tracker of positions alone has no second one.
    """

    position_sigma_m: float
    tangent_sigma_rad: float | None = None
