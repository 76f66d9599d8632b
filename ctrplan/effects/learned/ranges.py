"""The range of every input in the data that a term was built from: held at its edge outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.effects.learned.inputs import WHOLE_TURN_DEG, Situation, is_rotation, values


@dataclass(frozen=True)
class Range:
    """Of an input, in its own unit."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """Between the ends."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> float:
        """Of the width."""
        return max((self.high - self.low) / 2, 1e-12)

    @property
    def is_whole_turn(self) -> bool:
        """Whether a rotation has seen nearly all angles."""
        return self.high - self.low >= WHOLE_TURN_DEG

    def nearest(self, angle_deg: Array) -> Array:
        """(K,) the same angles, by whole turns as near to the middle as they come."""
        near: Array = angle_deg - 360.0 * np.round((angle_deg - self.middle) / 360.0)
        return near


Ranges = Mapping[str, Range]


def held(name: str, ranges: Ranges, at: Situation, *, periodic: bool = False) -> Array:
    """(K,) values of an input inside its range; its middle where the situation does not know it."""
    span, found = ranges[name], values(name, at)
    if found is None:
        return np.full(at.count, span.middle)
    found = np.where(np.isfinite(found), found, span.middle)
    if periodic and span.is_whole_turn:
        return found
    inside: Array = np.clip(span.nearest(found) if periodic else found, span.low, span.high)
    return inside


def outside(name: str, span: Range, at: Situation, *, periodic: bool) -> NDArray[np.bool_]:
    """(K,) whether an input is out of its range by more than a thousandth of it; one that nobody knows is not."""
    found = values(name, at)
    if found is None or (periodic and is_rotation(name) and span.is_whole_turn):
        return np.zeros(at.count, bool)
    near = span.nearest(found) if periodic else found
    far: NDArray[np.bool_] = np.abs(near - span.middle) > span.half * 1.001 + 1e-9
    return far
