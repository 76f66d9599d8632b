"""Friction states of a sample from those of the samples beside it.

Bodies in friction states bend away from the multilinear interpolation of the sign corners' bodies. How they do changes
slowly along a path and little with the mesh. A sample whose corners were solved takes it from the solved states of
the samples on both sides; what that may be off by is taken off the clearance.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ctrplan.mechanics.friction_cells import Doubts, bodies_between
from ctrplan.planning.certificate.allowances import BEND_CHANGE, BEND_MESH, BEND_SHARE, BEND_SPREAD
from ctrplan.planning.certificate.cell_clearances import BEYOND
from ctrplan.planning.certificate.friction_states import CornerShapes, Solved, State, corner_weights
from ctrplan.planning.certificate.sample_states import SampleStates


@dataclass(frozen=True, eq=False)
class StatesBetween:
    """Bodies by interpolation; stability and strain are those of the corners, multilinearly."""

    shapes: CornerShapes  # solved of the sample
    ends: tuple[SampleStates, SampleStates]  # on both sides
    share: float  # of the way from the first to the second
    is_finer: bool  # the sample's shapes are of a finer mesh than the ends

    def __call__(self, phi: Iterable[State]) -> list[Solved]:
        """Without a body where a sample beside this one has none."""
        states = list(phi)
        at, shapes = np.array(states), self.shapes
        weights = corner_weights(at)
        stability, strain = weights @ shapes.stability[1:], weights @ shapes.max_strain[1:]
        first, last = ((end.shares, end.bend(states)) for end in self.ends)
        doubts = Doubts(BEND_CHANGE, BEND_SHARE + (BEND_MESH if self.is_finer else 0.0), BEND_SPREAD, BEYOND)
        bodies, doubt = bodies_between(shapes.bodies_m, at, first, last, self.share, doubts)
        return [Solved(*row) for row in zip(bodies, stability.tolist(), strain.tolist(), doubt, strict=True)]
