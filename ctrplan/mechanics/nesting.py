"""Nesting: the tubes' bases and tips keep their order, collars apart, nothing pushed in front of the plate."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.tube import Tube

if TYPE_CHECKING:
    pass

TOLERANCE_M = 1e-9
# Of the base inside a tube with a compliant shaft, whose collar's angle is an unknown of its own: a node has to fit in
# between. The core asks for 0.02 mm; a little more stays above it whatever is rounded or differenced.
SHAFT_ROOM_M = 2.001e-5


def least_distance_m(outer: Tube, inner: Tube) -> float:
    """How far [m] behind the outer tube's base the inner one's has to be."""
    room = SHAFT_ROOM_M if outer.shaft_compliance_rad_per_Nm > 0 else 0.0
    return max(inner.collar_length_m, room)


def nesting_inequalities(tubes: Sequence[Tube]) -> tuple[Array, Array]:
    """G (2n - 1, n) and h (2n - 1,) [m] such that base translations l_b nest if and only if G @ l_b <= h.

    Rows: l_1b <= 0; then for every pair the bases, l_{i+1,b} <= l_ib - collar_{i+1}, or the room that a compliant shaft
    needs; then for every pair the tips, l_ib + length_i <= l_{i+1,b} + length_{i+1}.
    """
    behind = np.diff(np.eye(len(tubes)), axis=0)  # row i: l_{i+1} - l_i
    apart = [-least_distance_m(*pair) for pair in pairwise(tubes)]
    longer = np.diff([tube.length_m for tube in tubes])
    return np.vstack([np.eye(len(tubes))[:1], behind, -behind]), np.concatenate([[0.0], apart, longer])
