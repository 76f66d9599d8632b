"""What no friction state explains, as an offset of measured tips that changes slowly."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ctrplan.base.arguments import Number, checked


@checked(sigma_m=Number(0, 1, "m"), memory_steps=Number(1, math.inf))
@dataclass(frozen=True)
class SlowOffset:
    """A tip's offset in the tracker's frame: a normal error of each coordinate, correlated from step to step.

    Its correlation falls to 1/e in `memory_steps`. With inf it is a frame that stands somewhere else; with finite ones
    also what a model lacks, as far as that changes from step to step little.
    """

    sigma_m: float
    memory_steps: float = math.inf

    @property
    def kept(self) -> float:
        """What a step leaves of it."""
        return math.exp(-1.0 / self.memory_steps)
