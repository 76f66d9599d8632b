"""The rule of nesting: bases and tips keep their order, collars apart, no base in front of the plate.

Tips of retractable tubes need not: such a tube may end inside the one around it. The planner keeps them in order all
the same, for its certificates are of tips in order.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.mechanics.tube import Tube

TOLERANCE_M = 1e-9
# Of the base inside a tube with a compliant shaft, whose collar's angle is an unknown of its own: a node has to fit in
# between. The core asks for 0.02 mm; a little more stays above it whatever is rounded or differenced.
SHAFT_ROOM_M = 2.001e-5


def least_distance_m(outer: Tube, inner: Tube) -> float:
    """How far [m] behind the outer tube's base the inner one's has to be."""
    room = SHAFT_ROOM_M if outer.shaft_compliance_rad_per_Nm > 0 else 0.0
    return max(inner.collar_length_m, room)


def nesting_inequalities(tubes: Sequence[Tube], *, tips_in_order: bool = False) -> tuple[Array, Array]:
    """G (2n - 1, n) and h (2n - 1,) [m] such that base translations l_b nest if and only if G @ l_b <= h.

    Rows: l_1b <= 0; then for every pair the bases, l_{i+1,b} <= l_ib - collar_{i+1}, or the room that a compliant shaft
    needs; then for every pair the tips, l_ib + length_i <= l_{i+1,b} + length_{i+1}, which holds for retractable tubes
    in any case unless `tips_in_order`.
    """
    behind = np.diff(np.eye(len(tubes)), axis=0)  # row i: l_{i+1} - l_i
    apart = [-least_distance_m(*pair) for pair in pairwise(tubes)]
    longer = np.diff([tube.length_m for tube in tubes])
    longer[[tube.retractable and not tips_in_order for tube in tubes[1:]]] = np.inf
    return np.vstack([np.eye(len(tubes))[:1], behind, -behind]), np.concatenate([[0.0], apart, longer])


def reach_inequalities(tubes: Sequence[Tube]) -> tuple[Array, Array]:
    """The inequalities (2n, n), (2n,) [m] of nesting, and below them that of an outermost tip in front of the plate."""
    G, h = nesting_inequalities(tubes, tips_in_order=True)
    return np.vstack([G, -G[:1]]), np.append(h, tubes[0].length_m - 3 * TOLERANCE_M)


def nests(tubes: Sequence[Tube], l_b: Array) -> NDArray[np.bool_]:
    """(K,) whether base translations (K, n) [m] nest, the outermost tip in front of the plate; on the safe side.

    The core allows for twice the rounding, and has the last word.
    """
    G, h = nesting_inequalities(tubes)
    nested: NDArray[np.bool_] = np.all(l_b @ G.T <= h + TOLERANCE_M / 2, axis=1)
    return nested & (l_b[:, 0] + tubes[0].length_m > TOLERANCE_M)


def moved_to_nest(tubes: Sequence[Tube], l_b: Array) -> Array:
    """Base translations (K, n) [m] with those that do not nest moved to where they do, tube by tube from outside."""
    return _ordered(tubes, l_b, [least_distance_m(*pair) for pair in pairwise(tubes)])


def is_in_order(tubes: Sequence[Tube], l_b: Array, within_m: float) -> NDArray[np.bool_]:
    """(K,) whether collars and tips of (K, n) [m] are in order within so much; room for shafts is no matter."""
    ordered = _ordered(tubes, l_b, [tube.collar_length_m for tube in tubes[1:]])
    in_order: NDArray[np.bool_] = np.abs(ordered - l_b).max(axis=1, initial=0.0) < within_m
    return in_order


def _ordered(tubes: Sequence[Tube], l_b: Array, apart_m: Sequence[float]) -> Array:
    """Base translations (K, n) moved to where tips are in order and bases `apart_m`, a distance per pair."""
    l = l_b.copy()  # noqa: E741 (as in the equations)
    l[:, 0] = np.minimum(l[:, 0], 0.0)
    for i, (outer, inner) in enumerate(pairwise(tubes)):
        if not inner.retractable:
            l[:, i + 1] = np.maximum(l[:, i + 1], l[:, i] + outer.length_m - inner.length_m)
        l[:, i + 1] = np.minimum(l[:, i + 1], l[:, i] - apart_m[i])
    return l
