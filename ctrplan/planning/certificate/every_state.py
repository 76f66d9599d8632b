"""What walked pieces keep in every friction state, not in the solved shapes alone.

Pieces are walked on the mesh of the search. A sample whose clearance that mesh's allowance would take too much from is
solved once more on the certificate mesh.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.core import PathLimits
from ctrplan.planning.certificate.allowances import POINT_SPACING_M, SAME_BRANCH_M, TIGHT_M, mesh_allowance_m
from ctrplan.planning.certificate.anatomy_distance import AnatomyDistance
from ctrplan.planning.certificate.friction_cube import (
    DEPTH,
    LEAST_DEPTH,
    LeastOfStates,
    Needed,
    Solved,
    State,
    corner_states,
    least_of_states,
)
from ctrplan.planning.certificate.walked_piece import Piece, least_of, shapes_of
from ctrplan.planning.motion import path_limits

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.planning.scenario import Scenario

# Of samples near the anatomy all cells are halved once, of the others those of every few samples, some of them twice: a
# fold in the corner of a cell lasts for more than a few mm of motion.
NEAR_M, LOOK_EVERY, CLOSE_EVERY, CLOSE_DEPTH = 3e-3, 4, 16, 2
CLOSE_TUBES = 4  # of five tubes, cells halved twice have 881 corners and middles
CHUNK = 4  # samples at a time
MOST_AGAIN = 60  # samples solved on the certificate mesh only to report the least clearance more closely


@dataclass(eq=False)
class SampleStates:
    """A sample of a piece in its friction states, at an accuracy; compares what is solved with what was walked to."""

    scenario: Scenario
    piece: Piece
    sample: int
    accuracy: Accuracy
    apart_m: float = 0.0  # of bodies solved from scratch from those walked to, less what meshes differ by
    _compared: bool = field(default=False, repr=False)

    @property
    def states(self) -> list[State]:
        """phi = 0 and the sign corners, which were walked to."""
        pairs = self.scenario.robot.n - 1
        return [(0.0,) * pairs, *corner_states(pairs)]

    def known(self) -> tuple[dict[State, Solved], Array]:
        """The states that were walked to, on the certificate mesh solved once more, and outer radii (N,)."""
        bodies, radius = self.walked
        samples, k = self.piece.samples, self.sample
        if self.accuracy == self.piece.accuracy:
            numbers = zip(bodies, samples.shape_stability[k], samples.shape_max_strain[k], strict=True)
            solved = [Solved(body, float(stability), float(strain)) for body, stability, strain in numbers]
        else:
            bodies, radius, solved = self.solve(np.array(self.states))
            self.compare(bodies)
        return dict(zip(self.states, solved, strict=True)), radius

    @property
    def walked(self) -> tuple[Array, Array]:
        """Points (1 + C, N, 3) and outer radii (N,)."""
        return shapes_of(self.scenario, self.piece.samples.bodies[self.sample])

    def solve(self, phi: Array) -> tuple[Array, Array, list[Solved]]:
        """Points (S, N, 3), NaN where no equilibrium was found, radii (N,), and all of it by state."""
        found = self.scenario.robot.mechanics.friction_bodies(
            self.piece.theta_b[self.sample],
            self.piece.l_b[self.sample],
            phi,
            spacing_m=POINT_SPACING_M,
            accuracy=self.accuracy,
        )
        bodies = np.where(found.solved[:, None, None], found.point_m, np.nan)
        numbers = zip(bodies, found.stability.tolist(), found.max_strain.tolist(), strict=True)
        return bodies, found.radius_m, [Solved(*row) for row in numbers]

    def __call__(self, phi: Array) -> list[Solved]:
        """States (S, P); without a body where no equilibrium was found on the branch that was walked to."""
        first = np.empty((0, phi.shape[1])) if self._compared else np.array(self.states)
        bodies, _, solved = self.solve(np.vstack([first, phi]))
        if len(first):
            self.compare(bodies[: len(first)])
        if self.apart_m <= SAME_BRANCH_M:
            return solved[len(first) :]
        return [replace(one, body_m=np.full_like(one.body_m, np.nan)) for one in solved[len(first) :]]

    def compare(self, bodies: Array) -> None:
        """Those of `states` with what was walked to: whole bodies on the same mesh, tips on another one."""
        self._compared, walked = True, self.walked[0]
        if bodies.shape == walked.shape and self.accuracy == self.piece.accuracy:
            apart, allowed = np.linalg.norm(bodies - walked, axis=2), 0.0
        else:
            apart = np.linalg.norm(bodies[:, -1] - walked[:, -1], axis=1)
            allowed = mesh_allowance_m(self.scenario.robot, self.piece.accuracy)
        self.apart_m = max(0.0, float(np.nan_to_num(apart.max(), nan=np.inf)) - allowed)


def closely_solved(scenario: Scenario, pieces: Sequence[Piece]) -> list[Piece]:
    """The narrowest samples solved on the certificate mesh: all that the search mesh refuses, and some of the others.

    So that the least clearance does not depend on the mesh that a sample happened to be walked on.
    """
    distance, limits = AnatomyDistance.of(scenario), path_limits(scenario)
    if distance is None:
        return list(pieces)
    closer = [piece.clearance_m.copy() for piece in pieces]
    rows = sorted((float(c), p, k) for p, piece in enumerate(pieces) for k, c in enumerate(piece.clearance_m))
    narrow = [row for row in rows if pieces[row[1]].accuracy == "search"]
    must = sum(value < limits.clearance_m for value, *_ in narrow)
    ceiling = np.inf  # of the least clearance
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for begin in range(0, min(len(narrow), must + MOST_AGAIN), CHUNK):
            if narrow[begin][0] >= ceiling or ceiling < limits.clearance_m:
                break
            chunk = narrow[begin : begin + CHUNK]
            values = pool.map(lambda row: _on_certificate_mesh(scenario, distance, pieces[row[1]], row[2]), chunk)
            for (value, p, k), found in zip(chunk, values, strict=True):
                closer[p][k] = max(value, found)
                ceiling = min(ceiling, closer[p][k])
    return [replace(piece, clearance_m=values) for piece, values in zip(pieces, closer, strict=True)]


def in_every_friction_state(scenario: Scenario, pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces with clearance, stability and strain of every friction state.

    Where no state is found to have less than the solved shapes of the whole path, the least clearance is that of those
    shapes less TIGHT_M.
    """
    limits = path_limits(scenario)
    if scenario.robot.n == 1 or not scenario.robot.friction.any():
        return list(pieces)
    solved = least_of(pieces)
    enough = limits.clearance_m if solved < limits.clearance_m else max(limits.clearance_m, solved - TIGHT_M)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(lambda piece: _in_every_state(scenario, piece, enough, limits), pieces))


def _on_certificate_mesh(scenario: Scenario, distance: AnatomyDistance, piece: Piece, sample: int) -> float:
    """Clearance of the solved shapes of a sample, all allowances taken off; -inf on another branch."""
    states = SampleStates(scenario, piece, sample, "certificate")
    bodies, radius, _ = states.solve(np.array(states.states))
    states.compare(bodies)
    if states.apart_m > SAME_BRANCH_M:
        return -np.inf
    points, count = bodies.reshape(-1, 3), len(bodies)
    owner = np.zeros(len(points), dtype=np.intp)
    least = float(distance.least(points, np.tile(radius, count), owner, 1)[0])
    return least - float(piece.offset_m(scenario, "certificate")[sample])


def _in_every_state(scenario: Scenario, piece: Piece, enough_m: float, limits: PathLimits) -> Piece:
    """Down to `enough_m` of clearance; ends at the first sample that breaks a limit."""
    distance = AnatomyDistance.of(scenario)
    clearance, stability, strain = piece.clearance_m.copy(), piece.stability.copy(), piece.max_strain.copy()
    phi, apart = piece.phi.copy(), 0.0
    for k in range(len(clearance)):
        found, apart_here = _least(scenario, distance, piece, k, Needed(enough_m, limits.stability, limits.max_strain))
        if found.clearance_m < clearance[k]:
            clearance[k], phi[k] = found.clearance_m, found.phi
        stability[k] = min(stability[k], found.stability)
        strain[k] = max(strain[k], found.max_strain)
        apart = max(apart, apart_here)
        if clearance[k] < limits.clearance_m or stability[k] < limits.stability or strain[k] > limits.max_strain:
            break
    return replace(piece, clearance_m=clearance, stability=stability, max_strain=strain, phi=phi, apart_m=apart)


def _least(
    scenario: Scenario, distance: AnatomyDistance | None, piece: Piece, sample: int, needed: Needed
) -> tuple[LeastOfStates, float]:
    """Of a sample, all allowances taken off the clearance; and how far its shapes lay from those walked to.

    The search mesh decides where one look is enough.
    """
    states = SampleStates(scenario, piece, sample, piece.accuracy)
    depth = LEAST_DEPTH if piece.accuracy == "search" else DEPTH
    is_hopeful = piece.as_walked_m[sample] >= needed.clearance_m
    if piece.accuracy == "search" and not is_hopeful:
        return _least_of(states, distance, needed, DEPTH, "certificate")
    found, apart = _least_of(states, distance, needed, depth, piece.accuracy)
    if piece.accuracy != "search" or found.keeps(needed) or not np.isfinite(found.clearance_m):
        return found, apart
    finer, apart_finer = _least_of(states, distance, needed, DEPTH, "certificate")
    return finer, max(apart, apart_finer)


def _least_depth(walked: SampleStates, needed: Needed) -> int:
    """How often all cells of a sample are halved."""
    if walked.sample % CLOSE_EVERY == 0 and walked.scenario.robot.n <= CLOSE_TUBES:
        return CLOSE_DEPTH
    is_near = walked.piece.as_walked_m[walked.sample] < needed.clearance_m + NEAR_M
    return LEAST_DEPTH if is_near or walked.sample % LOOK_EVERY == 0 else 0


def _least_of(
    walked: SampleStates, distance: AnatomyDistance | None, needed: Needed, depth: int, accuracy: Accuracy
) -> tuple[LeastOfStates, float]:
    states = SampleStates(walked.scenario, walked.piece, walked.sample, accuracy)
    offset = float(walked.piece.offset_m(walked.scenario, accuracy)[walked.sample])
    known, radius = states.known()
    asked = replace(needed, clearance_m=needed.clearance_m + offset)
    found = least_of_states(known, radius, states, distance, asked, depth, _least_depth(walked, needed))
    return replace(found, clearance_m=found.clearance_m - offset), states.apart_m
