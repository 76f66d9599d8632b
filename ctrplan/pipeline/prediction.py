"""What a sensor should read, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the sensor should read at K poses, and derivatives by the P parameters of all terms."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    sound: NDArray[np.bool_]  # (K,)
    failed: NDArray[np.bool_]  # (K,) without a solution: position and tangent are those of the last iterate
    position_by: Array  # (K, 3, P)
    tangent_by: Array  # (K, 3, P)

    def subset(self, poses: NDArray[np.bool_]) -> Prediction:
        """Some of the poses only, given by a mask (K,)."""
        return Prediction(*(getattr(self, name)[poses] for name in Prediction.__dataclass_fields__))
