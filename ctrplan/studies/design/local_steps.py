"""Steps from the best designs of a search, down the exact derivatives of the error by the parameters.

A step counts where the error at worst falls - that with tolerances, if it is an objective - and no target is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.studies.design.front import Looked, judged
from ctrplan.studies.design.space import Design, DesignSpace, name_of

FIRST, LEAST = 0.1, 0.01  # shares of the ranges
LONGER, SHORTER = 1.5, 0.4

Look = Callable[[Sequence[Design]], Sequence[Looked]]


@dataclass(eq=False)
class Descent:
    """Where one descent is."""

    at: Looked
    step: float = FIRST
    tried: set[tuple[object, ...]] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Where it begins is known."""
        self.tried.add(self.at.design.key)

    def proposal(self, space: DesignSpace) -> Design | None:
        """The next design, a step down that was not tried; None where there is no way down."""
        down = downhill(space, self.at)
        while self.step >= LEAST and down.any():
            shares = np.clip(np.array(self.at.design.shares) + self.step * down, 0.0, 1.0)
            found = space.design(shares.tolist())
            if found.key not in self.tried and space.strain(found) <= space.entry.made.most_strain:
                self.tried.add(found.key)
                return found
            self.step *= SHORTER
        return None

    def judge(self, looked: Looked, objective: str) -> None:
        """Goes on from a design that is better, else tries a shorter step."""
        if is_better(looked, self.at, objective):
            self.at, self.step = looked, self.step * LONGER
        else:
            self.step *= SHORTER


def descend(
    space: DesignSpace, best: Sequence[Looked], steps: int, objectives: Sequence[str], look: Look
) -> list[Looked]:
    """So many steps from each design, all of them together; where each ends."""
    objective = judged(objectives)
    descents = [Descent(looked) for looked in best]
    for _ in range(steps):
        asked = [(descent, made) for descent in descents if (made := descent.proposal(space))]
        if not asked:
            break
        for (descent, _), looked in zip(asked, look([made for _, made in asked]), strict=True):
            descent.judge(looked, objective)
    return [descent.at for descent in descents]


def is_better(new: Looked, old: Looked, objective: str) -> bool:
    """Whether the error is less and as many targets are reached."""
    if not new.is_done:
        return False
    return bool(new.numbers[objective] < old.numbers[objective] and new.numbers["reach"] >= old.numbers["reach"])


def downhill(space: DesignSpace, looked: Looked) -> Array:
    """Direction in shares along which the error falls fastest, its largest part 1 or -1; zero where it can't fall.

    Tubes stay what they are. What is at an end of its range does not move beyond it.
    """
    widths = {side.name: side.width for side, _, _ in space.sides(looked.design)}
    by_share = np.zeros(len(looked.design.shares))
    for k, parameter in enumerate(space.parameters, start=space.tubes):
        slope = looked.numbers[f"slope.{name_of(parameter)}"] / widths[name_of(parameter)]
        by_share[k] = slope * (parameter.high - parameter.low)
    shares = np.array(looked.design.shares)
    held = ((shares <= 0) & (by_share > 0)) | ((shares >= 1) & (by_share < 0))
    down = np.where(held, 0.0, -by_share)
    largest = np.abs(down).max(initial=0.0)
    found: Array = down / largest if largest > 0 else down
    return found
