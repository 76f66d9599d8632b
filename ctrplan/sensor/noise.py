"""How exactly a tracker measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of each coordinate of the tip and of a small rotation of its tangent about each axis."""

    position_sigma_m: float
    tangent_sigma_rad: float
