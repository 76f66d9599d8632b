"""Friction states that a robot of which nothing is known is followed from."""

from __future__ import annotations

import itertools

import numpy as np

from ctrplan.base.arrays import Array

MOST_CORNERS = 32  # of five pairs; of more pairs as many are drawn
LEAST_SPACING = 0.25  # of a state, which friction can be told apart by


def start_states(pairs: int, members: int, rng: np.random.Generator) -> list[Array]:
    """Shares (P,) of the Coulomb limit: released, every sign corner, and others of a grid, `members` of them or more.

    With the corners of many pairs there are more. A single tube has one state.
    """
    if pairs == 0:
        return [np.zeros(0)]
    found = [np.zeros(pairs), *_corners(pairs, rng)]
    levels = max(3, _levels_within(members, pairs))
    between = [np.array(state) for state in itertools.islice(itertools.product(_grid(levels), repeat=pairs), 10_000)]
    rng.shuffle(between)  # of a grid that is not used whole, any
    taken = {tuple(state) for state in found}
    for state in between:
        if len(found) < members and tuple(state) not in taken:
            found.append(state)
    return found


def states_nearby(phi: Array, count: int, spread: float, rng: np.random.Generator) -> list[Array]:
    """`count` states (P,), half of them near phi (P,), the others anywhere."""
    near = np.clip(phi + spread * rng.standard_normal((count, len(phi))), -1, 1)
    anywhere = rng.uniform(-1, 1, (count, len(phi)))
    return [near[k] if k % 2 == 0 else anywhere[k] for k in range(count)]


def _corners(pairs: int, rng: np.random.Generator) -> list[Array]:
    if 2**pairs <= MOST_CORNERS:
        return [np.array(signs) for signs in itertools.product((1.0, -1.0), repeat=pairs)]
    return list(np.unique(rng.choice([1.0, -1.0], (MOST_CORNERS, pairs)), axis=0))


def _levels_within(members: int, pairs: int) -> int:
    """Odd number of levels per pair whose grid has at most `members` states."""
    levels = min(int((members + 1e-9) ** (1 / pairs)), round(2 / LEAST_SPACING) + 1)
    return levels - (levels + 1) % 2


def _grid(levels: int) -> list[float]:
    return [float(level) + 0.0 for level in np.linspace(-1, 1, levels)]
