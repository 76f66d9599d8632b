"""A commanded path: waypoints in the order visited."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class JointPath:
    """K waypoints of n tubes in the order visited; between them all joints move together linearly."""

    theta_commanded: Array  # (K, n) base rotations, rad, not wrapped
    l_commanded: Array  # (K, n) base translations, m
    sequence: NDArray[np.int_]  # (K,) runs, each approached afresh
    time_s: Array | None = None  # (K,)
    file: str | None = None
    more: Mapping[str, Array] = field(default_factory=dict)  # other columns (K,), NaN where blank
    notes: tuple[str, ...] = ()  # how the file was read, a sentence each
    of_collars: bool = False  # whether joints are those of the collars, so that the drive's effects are in them

    @property
    def runs(self) -> list[slice]:
        """Rows of each run."""
        starts = [*np.flatnonzero(np.diff(self.sequence, prepend=np.nan) != 0).tolist(), len(self.sequence)]
        return [slice(a, b) for a, b in zip(starts, starts[1:], strict=False)]
