"""The states of one sample of a walked piece: solved, or interpolated along the path between samples that were.

Bodies in friction states bend away from the multilinear interpolation of the sign corners' bodies. How they do changes
slowly along a path and little with the mesh. A sample whose corners were solved takes it from the solved states of
the samples on both sides; what that may be off by is taken off the clearance.

Where stated intervals or play of the drive move the body much, they are further axes of the cube (`variants.py`): a
state is then a friction state phi, and a place s in the box of what the robot may be.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array, alike, lengths, shares_of_length
from ctrplan.certificate.friction_cube import BEYOND
from ctrplan.certificate.friction_states import (
    BEND_CHANGE,
    BEND_MESH,
    BEND_SHARE,
    BEND_SPREAD,
    POINT_SPACING_M,
    CornerShapes,
    Solved,
    State,
    corner_states,
    corner_weights,
    mesh_allowance_m,
)
from ctrplan.certificate.variants import Point
from ctrplan.certificate.walked_piece import Piece, filled_radius
from ctrplan.mechanics.equilibria import SAME_SHAPE_M
from ctrplan.mechanics.friction import Doubts, bodies_between
from ctrplan.mechanics.shapes import FrictionBodies

if TYPE_CHECKING:
    from ctrplan.mechanics.friction import FrictionStates
    from ctrplan.mechanics.shapes import Accuracy
    from ctrplan.scenario.scenario import Scenario

NUMBERS = ("stability", "max_strain", "solved")  # of friction bodies, one a state


@dataclass(eq=False)
class SampleStates:
    """A sample of a piece in its friction states, at an accuracy; compares what is solved with what was walked to.

    Threads that look at the samples on either side may ask for its states at once.
    """

    scenario: Scenario
    piece: Piece
    sample: int
    accuracy: Accuracy
    apart_m: float = 0.0  # of bodies solved from scratch from those walked to, less what meshes differ by
    _compared: bool = field(default=False, repr=False)
    _solved: dict[State, Solved] = field(default_factory=dict, repr=False)
    _starts: dict[Point, FrictionStates] = field(default_factory=dict, repr=False)  # of points of the box
    _bends: dict[tuple[State, ...], Array] = field(default_factory=dict, repr=False)
    _lock: RLock = field(default_factory=RLock, repr=False)  # so that nothing is solved twice

    @property
    def states(self) -> list[State]:
        """All zero and the sign corners, which were walked to."""
        dimensions = self.piece.phi.shape[1]
        return [(0.0,) * dimensions, *corner_states(dimensions)]

    @cached_property
    def known(self) -> CornerShapes:
        """What was walked to, on the certificate mesh solved once more."""
        if self.accuracy == self.piece.accuracy:
            return self.walked
        if (finer := self.piece.finer.get((self.sample, self.accuracy))) is not None:
            return finer
        with self._lock:
            result = self.solve(self.states)
            self._compare(result.point_m)
        filled = self.walked.radius_m
        if len(filled) != result.point_m.shape[1]:
            filled = filled_radius(result.radius_m, result.point_m[0], self.piece, self.sample)
        return CornerShapes(result.point_m, result.stability, result.max_strain, filled)

    @cached_property
    def walked(self) -> CornerShapes:
        """The shapes of this sample as they were walked to, on the mesh of the walk."""
        return self.piece.shapes(self.sample)

    def let_go(self) -> None:
        """Forgets what further states would be solved from: it is solved anew if they are needed."""
        with self._lock:
            self._starts.clear()

    def solve(self, states: Iterable[State]) -> FrictionBodies:
        """Points (S, N, 3) are NaN where no equilibrium was found.

        The file's robot has the state of all zeros that comes first: its frictionless shape.
        """
        given = np.array(list(states))
        pairs, results = self.piece.pairs, dict[int, FrictionBodies]()
        points = [tuple(row) for row in given[:, pairs:].tolist()]
        for point in dict.fromkeys(points):
            rows = [k for k, other in enumerate(points) if other == point]
            bodies = self._at(point).bodies(given[rows, :pairs], spacing_m=POINT_SPACING_M)
            results |= {row: _row(bodies, k) for k, row in enumerate(rows)}
        pattern = self._pattern if self.piece.variants.large else results[0].point_m[0]
        return _joined([results[k] for k in range(len(given))], pattern)

    @property
    def _pattern(self) -> Array:
        """(N, 3) the body whose points those of other robots are."""
        finer = self.piece.finer.get((self.sample, self.accuracy))
        body: Array = (finer or self.walked).bodies_m[0]
        return body

    def _at(self, s: Point) -> FrictionStates:
        """The configuration at s (A,) of the large axes."""
        if s not in self._starts:
            piece, k = self.piece, self.sample
            if piece.variants.large:
                at = piece.variants.configuration(piece.variants.at(s), piece.joints[k], self.accuracy)
            else:
                mechanics = self.scenario.robot.mechanics
                at = mechanics.friction_states(piece.theta_b[k], piece.l_b[k], accuracy=self.accuracy)
            self._starts[s] = at
        return self._starts[s]

    def __call__(self, phi: Iterable[State]) -> list[Solved]:
        """Without a body where no equilibrium was found on the branch that was walked to."""
        states = list(phi)
        with self._lock:
            if unsolved := [state for state in states if state not in self._solved]:
                first = [] if self._compared else self.states
                result = self.solve([*first, *unsolved])
                if first:
                    self._compare(result.point_m[: len(first)])
                rows = zip(result.point_m, result.stability.tolist(), result.max_strain.tolist(), strict=True)
                solved = [Solved(*row) for row in rows]
                self._solved |= dict(zip(unsolved, solved[len(first) :], strict=True))
        of_states = [self._solved[state] for state in states]
        if self.apart_m <= SAME_SHAPE_M:
            return of_states
        return [replace(state, body_m=np.full_like(state.body_m, np.nan)) for state in of_states]

    def bend(self, states: Sequence[State]) -> Array:
        """(S, N, 3) how far bodies of S states lie from the multilinear interpolation of the sign corners' bodies.

        NaN where there is no equilibrium.
        """
        key = tuple(states)
        with self._lock:
            if key not in self._bends:
                weights = corner_weights(np.array(key))
                straight = np.tensordot(weights, self.known.bodies_m[1:], axes=1)
                self._bends[key] = np.array([solved.body_m for solved in self(key)]) - straight
            return self._bends[key]

    @cached_property
    def shares(self) -> Array:
        """(N,) of the body's length, at its points."""
        return shares_of_length(self.known.bodies_m[0])

    def _compare(self, bodies: Array) -> None:
        """Those of `states` with what was walked to: whole bodies on the same mesh, tips on another one."""
        self._compared, walked = True, self.walked.bodies_m
        if self.piece.variants.large and not self.piece.variants.has_middle:  # the file's robot is not the middle
            bodies, walked = bodies[1:], walked[1:]
        if bodies.shape == walked.shape and self.accuracy == self.piece.accuracy:
            apart, allowed = lengths(bodies - walked), 0.0
        else:
            apart = lengths(bodies[:, -1] - walked[:, -1])
            allowed = mesh_allowance_m(self.scenario.robot, self.piece.accuracy)
        self.apart_m = max(0.0, float(np.nan_to_num(apart.max(), nan=np.inf)) - allowed)


def _row(bodies: FrictionBodies, k: int) -> FrictionBodies:
    """One of the states alone; without points where no equilibrium was found."""
    point = bodies.point_m[k : k + 1]
    return replace(
        bodies,
        point_m=point if bodies.solved[k] else np.full_like(point, np.nan),
        **{name: getattr(bodies, name)[k : k + 1] for name in NUMBERS},
    )


def _joined(rows: Sequence[FrictionBodies], pattern: Array) -> FrictionBodies:
    """Several states in one, all on as many points as a body (N, 3)."""
    columns = {name: np.concatenate([getattr(row, name) for row in rows]) for name in NUMBERS}
    points = np.concatenate([alike(row.point_m, pattern) for row in rows])
    return replace(rows[0], point_m=points, **columns)


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
