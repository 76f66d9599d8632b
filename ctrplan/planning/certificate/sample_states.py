"""A sample of a walked piece in its friction states."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array, lengths
from ctrplan.planning.certificate.allowances import POINT_SPACING_M, SAME_BRANCH_M, mesh_allowance_m
from ctrplan.planning.certificate.friction_states import (
    CornerShapes,
    Solved,
    State,
    corner_states,
    corner_weights,
)
from ctrplan.planning.certificate.walked_piece import Piece, shapes_of

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.mechanics.friction_states import FrictionStates
    from ctrplan.mechanics.shapes import FrictionBodies
    from ctrplan.planning.scenario import Scenario


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
    _start: FrictionStates | None = field(default=None, repr=False)  # of all states that are solved
    _bends: dict[tuple[State, ...], Array] = field(default_factory=dict, repr=False)
    _lock: RLock = field(default_factory=RLock, repr=False)  # so that nothing is solved twice

    @property
    def states(self) -> list[State]:
        """phi = 0 and the sign corners, which were walked to."""
        pairs = self.scenario.robot.n - 1
        return [(0.0,) * pairs, *corner_states(pairs)]

    @cached_property
    def known(self) -> CornerShapes:
        """What was walked to, on the certificate mesh solved once more."""
        samples, k = self.piece.samples, self.sample
        if self.accuracy == self.piece.accuracy:
            bodies, radius = self.walked
            return CornerShapes(bodies, samples.shape_stability[k], samples.shape_max_strain[k], radius)
        if k in self.piece.finer:
            return self.piece.finer[k]
        with self._lock:
            found = self.solve(self.states)
            self._compare(found.point_m)
        return CornerShapes(found.point_m, found.stability, found.max_strain, found.radius_m)

    @cached_property
    def walked(self) -> tuple[Array, Array]:
        """Points (1 + C, N, 3) and outer radii (N,)."""
        return shapes_of(self.scenario, self.piece.samples.bodies[self.sample])

    def let_go(self) -> None:
        """Of what further states would be solved from: it is found anew if they are asked for."""
        with self._lock:
            self._start = None

    def solve(self, phi: Iterable[State]) -> FrictionBodies:
        """Points (S, N, 3) are NaN where no equilibrium was found."""
        if self._start is None:
            at = self.piece.theta_b[self.sample], self.piece.l_b[self.sample]
            self._start = self.scenario.robot.mechanics.friction_states(*at, accuracy=self.accuracy)
        found = self._start.bodies(np.array(list(phi)), spacing_m=POINT_SPACING_M)
        return (
            found
            if found.solved.all()
            else replace(found, point_m=np.where(found.solved[:, None, None], found.point_m, np.nan))
        )

    def __call__(self, phi: Iterable[State]) -> list[Solved]:
        """Without a body where no equilibrium was found on the branch that was walked to."""
        asked = list(phi)
        with self._lock:
            if wanted := [state for state in asked if state not in self._solved]:
                first = [] if self._compared else self.states
                found = self.solve([*first, *wanted])
                if first:
                    self._compare(found.point_m[: len(first)])
                rows = zip(found.point_m, found.stability.tolist(), found.max_strain.tolist(), strict=True)
                solved = [Solved(*row) for row in rows]
                self._solved |= dict(zip(wanted, solved[len(first) :], strict=True))
        states = [self._solved[state] for state in asked]
        if self.apart_m <= SAME_BRANCH_M:
            return states
        return [replace(one, body_m=np.full_like(one.body_m, np.nan)) for one in states]

    def bend(self, states: Sequence[State]) -> Array:
        """(S, N, 3) how far bodies of S states lie from the multilinear interpolation of the sign corners' bodies.

        NaN where there is no equilibrium.
        """
        asked = tuple(states)
        with self._lock:
            if asked not in self._bends:
                weights = corner_weights(np.array(asked))
                straight = np.tensordot(weights, self.known.bodies_m[1:], axes=1)
                self._bends[asked] = np.array([one.body_m for one in self(asked)]) - straight
            return self._bends[asked]

    @cached_property
    def shares(self) -> Array:
        """(N,) of the body's length, at its points."""
        return shares_of_length(self.known.bodies_m[0])

    def _compare(self, bodies: Array) -> None:
        """Those of `states` with what was walked to: whole bodies on the same mesh, tips on another one."""
        self._compared, walked = True, self.walked[0]
        if bodies.shape == walked.shape and self.accuracy == self.piece.accuracy:
            apart, allowed = lengths(bodies - walked), 0.0
        else:
            apart = lengths(bodies[:, -1] - walked[:, -1])
            allowed = mesh_allowance_m(self.scenario.robot, self.piece.accuracy)
        self.apart_m = max(0.0, float(np.nan_to_num(apart.max(), nan=np.inf)) - allowed)


def shares_of_length(body_m: Array) -> Array:
    """(N,) share of a body's length at its points (N, 3)."""
    length = np.append(0.0, np.cumsum(lengths(np.diff(body_m, axis=0))))
    share: Array = length / length[-1]
    return share
