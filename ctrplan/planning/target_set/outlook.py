"""What a design can still become while its targets are looked at one by one: whether going on is worth it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Values = Mapping[str, float]
LESS_IS_BETTER = {"error_mm": True, "robust_mm": True, "reach": False, "stability": False, "clearance_mm": False}


def dominates(a: Values, b: Values) -> bool:
    """Whether a is nowhere worse than b and somewhere better; both have the same objectives."""
    costs = [(cost(name, a[name]), cost(name, b[name])) for name in b]
    return all(x <= y for x, y in costs) and any(x < y for x, y in costs)


def cost(name: str, value: float) -> float:
    """An objective's value so that less is better."""
    return value if LESS_IS_BETTER[name] else -value


@dataclass(frozen=True)
class Outlook:
    """The best that is still possible with `count` targets: what is left is taken to be reached without any error."""

    count: int
    unreached_mm: float
    errors_mm: tuple[float, ...] = ()  # of targets that are settled, unreached_mm where they are not reached
    stability: float = math.inf
    clearance_mm: float = math.inf

    def with_target(
        self, error_mm: float | None, stability: float = math.inf, clearance_mm: float = math.inf
    ) -> Outlook:
        """After one more target; None: it is not reached."""
        lost = self.unreached_mm if error_mm is None else min(error_mm, self.unreached_mm)
        least = min(self.stability, stability), min(self.clearance_mm, clearance_mm)
        return Outlook(self.count, self.unreached_mm, (*self.errors_mm, lost), *least)

    def best(self, reached: int) -> dict[str, float]:
        """Values that no objective can be better than, `reached` of the settled targets being reached."""
        error_mm = math.fsum(self.errors_mm) / self.count
        return {
            "error_mm": error_mm,
            "robust_mm": error_mm,
            "reach": (self.count - len(self.errors_mm) + reached) / self.count,
            "stability": self.stability,
            "clearance_mm": self.clearance_mm,
        }

    def is_hopeless(self, reached: int, front: Sequence[Values]) -> bool:
        """Whether a design of the front is better than the best that this one can become."""
        best = self.best(reached)
        return any(dominates(known, {name: best[name] for name in known}) for known in front)
