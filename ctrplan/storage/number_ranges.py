"""Numbers, points and names as people write them into files, each with the finite range that it may have.

No number of a file is without a range: beyond it a value is in another unit, or nothing can be computed with it.
`LARGEST_NUMBER` holds where a file's table is read by whoever extends ctrplan and states none.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from ctrplan.base.arrays import Array, read_only
from ctrplan.base.units import LONGEST_MM, MOST_TURNS_DEG

LARGEST_NUMBER = 1e12
LARGEST_WEIGHT = 1e6
FINEST_MM = 1e-3  # finer than any solve

Name = Annotated[str, Meta(min_length=1, max_length=80)]
Length = Annotated[float, Meta(gt=0, le=LONGEST_MM)]  # mm
Distance = Annotated[float, Meta(ge=0, le=LONGEST_MM)]  # mm
Tolerance = Annotated[float, Meta(ge=FINEST_MM, le=1000)]  # mm
Angle = Annotated[float, Meta(ge=-MOST_TURNS_DEG, le=MOST_TURNS_DEG)]  # deg
Weight = Annotated[float, Meta(ge=0, le=LARGEST_WEIGHT)]  # of a term in a sum
Fraction = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1, le=100_000)]
Component = Annotated[float, Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]  # of a vector whose length does not matter
Vector = tuple[Component, Component, Component]
Coordinate = Annotated[float, Meta(ge=-LONGEST_MM, le=LONGEST_MM)]  # mm
Point = tuple[Coordinate, Coordinate, Coordinate]  # mm


def metres(point_mm: Point) -> Array:
    """(3,) [m] of a point in mm, read-only."""
    return read_only(np.multiply(point_mm, 1e-3))
