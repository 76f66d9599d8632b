"""Numbers, points and names as people write them into files, with the limits that every file shares."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from ctrplan.base.arrays import Array, read_only

Name = Annotated[str, Meta(min_length=1, max_length=80)]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1)]
Vector = tuple[float, float, float]
Coordinate = Annotated[float, Meta(ge=-1e5, le=1e5)]  # mm; beyond it the value is in another unit
Point = tuple[Coordinate, Coordinate, Coordinate]  # mm


def metres(point_mm: Point) -> Array:
    """(3,) [m] of a point in mm, read-only."""
    return read_only(np.multiply(point_mm, 1e-3))
