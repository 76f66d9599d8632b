"""The arrays of all rooms: float64, and read-only where objects are shared between threads."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def read_only(values: ArrayLike) -> NDArray[Any]:
    """A copy of `values` that nobody can change: robots are shared between threads."""
    array = np.array(values)
    array.setflags(write=False)
    return array
