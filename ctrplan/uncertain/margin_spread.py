"""Stability and strain of a configuration's friction states, and where the intervals may take them.

Both are differenced with the bodies, at one end of every axis of the box (`body_spread.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.worst_case import OffsetBox

Solve = Callable[[Array], Array]  # (P,) away from the values -> (S,); NaN without an equilibrium


@dataclass(frozen=True, eq=False)
class MarginSpread:
    """A number of S friction states; the larger the better. NaN where there is no equilibrium."""

    value: Array  # (S,)
    middle: Array  # (S,) change at the middle of the intervals
    sides: Array  # (S, A) further change at the end of each axis of the box

    def lost(self, parameters: UncertainParameters, solve: Solve) -> float:
        """How much the least may fall within the intervals: to first order, and what the worst combination, solved,
        differs by. inf where some robot has no equilibrium.
        """
        if not parameters.count:
            return 0.0
        if np.isnan(self.value).any() or np.isnan(self.middle).any() or np.isnan(self.sides).any():
            return np.inf
        least = self.value + self.middle - np.abs(self.sides).sum(axis=1)
        state, box = int(np.argmin(least)), OffsetBox.of(parameters)
        solved = float(solve(box.middle - box.axes @ np.sign(self.sides[state]))[state])
        beyond = np.nan_to_num(abs(solved - least[state]), nan=np.inf)
        return max(float(self.value.min() - least[state] + beyond), 0.0)
