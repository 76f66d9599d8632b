"""Friction states of a sample from those of the samples beside it.

Bodies in friction states bend away from the multilinear interpolation of the sign corners' bodies. How they do changes
slowly along a path and little with the mesh. A sample whose corners were solved takes it from the solved states of
the samples on both sides; what that may be off by is taken off the clearance.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array, lengths
from ctrplan.planning.certificate.allowances import BEND_CHANGE, BEND_MESH, BEND_SHARE, BEND_SPREAD
from ctrplan.planning.certificate.cell_clearances import BEYOND
from ctrplan.planning.certificate.friction_states import Solved, State, corner_states, corner_weights
from ctrplan.planning.certificate.sample_states import SampleStates, shares_of_length


@dataclass(frozen=True, eq=False)
class StatesBetween:
    """Bodies by interpolation; stability and strain are those of the corners, multilinearly."""

    shapes: dict[State, Solved]  # solved of the sample: phi = 0 and the sign corners
    ends: tuple[SampleStates, SampleStates]  # on both sides
    share: float  # of the way from the first to the second
    is_finer: bool  # the sample's shapes are of a finer mesh than the ends

    def __call__(self, phi: Iterable[State]) -> list[Solved]:
        """Without a body where a sample beside this one has none."""
        states = list(phi)
        weights, pairs = corner_weights(np.array(states)), len(states[0])
        corners, rest = [self.shapes[state] for state in corner_states(pairs)], self.shapes[(0.0,) * pairs].body_m
        stability = weights @ [corner.stability for corner in corners]
        strain = weights @ [corner.max_strain for corner in corners]
        at = shares_of_length(rest)
        first, last = (_moved_to(at, end.shares, end.bend(states)) for end in self.ends)
        bend = (1 - self.share) * first + self.share * last
        share = BEND_SHARE + (BEND_MESH if self.is_finer else 0.0)
        doubt = BEND_CHANGE * lengths(first - last) + share * lengths(bend)
        bodies_of_corners = np.array([corner.body_m for corner in corners])
        doubt += BEND_SPREAD * lengths(bodies_of_corners - rest).max(axis=0)
        bodies = np.tensordot(weights, bodies_of_corners, axes=1) + bend
        rows = zip(bodies, stability.tolist(), strain.tolist(), most_up_to(doubt), strict=True)
        return [Solved(*row) for row in rows]


def _moved_to(wanted: Array, own: Array, values: Array) -> Array:
    """(S, M, 3) values (S, N, 3) of a body, known at shares `own` (N,) of its length, at the shares wanted (M,)."""
    after = np.clip(np.searchsorted(own, wanted), 1, len(own) - 1)
    part = ((wanted - own[after - 1]) / (own[after] - own[after - 1]))[:, None]
    moved: Array = values[:, after - 1] * (1 - part) + values[:, after] * part
    return moved


def most_up_to(apart_m: Array) -> Array:
    """(..., N) [m] of distances at points the largest from the base up to BEYOND points further out."""
    most: Array = np.maximum.accumulate(apart_m, axis=-1)
    count = most.shape[-1]
    return most[..., np.minimum(np.arange(count) + BEYOND, count - 1)]
