"""Where a solver ended."""

from __future__ import annotations

from dataclasses import dataclass

from paper_oracle.se3 import Array


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a solver ended."""

    u: Array  # (E, 3) [1/m]
    frames: Array  # (E + n, 3, 3)
    points: Array  # (E + n, 3) [m]
    multiplier: Array  # (M,) lambda [N/m]
    converged: bool  # all loops, by their own criteria
    outer: int  # linearisations, or Newton steps
    inner: int  # iterations of the ascent, all together
    step: float  # last |Delta u| [1/m]; nan from Newton

    @property
    def tip_m(self) -> Array:
        tip: Array = self.points[-1]
        return tip
