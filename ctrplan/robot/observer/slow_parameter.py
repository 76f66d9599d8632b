"""Numbers of the robot that an observer estimates beside the friction states."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ctrplan.base.arguments import Number, checked


@checked(sigma=Number(0, 1e6, above=True), memory_steps=Number(1, math.inf))
@dataclass(frozen=True)
class SlowParameter:
    """A number that is off its value in the robot file by a normal error, and changes slowly if at all.

    Names as those of `Mechanics.tips_with_friction`: contact.1.friction_coefficient, tube.2.poisson_ratio, theta_b.2 or
    l_b.3 for the zero of a collar. SI. The correlation of its error falls to 1/e in `memory_steps`.
    """

    name: str
    sigma: float
    memory_steps: float = 200.0

    @property
    def is_of_collar(self) -> bool:
        """Whether it is the zero of a collar, which is no number of the mechanics."""
        return self.name.split(".")[0] in ("theta_b", "l_b")
