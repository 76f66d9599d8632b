"""Pieces of legs walked densely for a certificate, and the clearance of every friction state on them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress
from ctrplan.mechanics.core import PathDensity, PathSamples
from ctrplan.planning.certificate.anatomy_distance import AnatomyDistance
from ctrplan.planning.certificate.friction_cube import State, corner_states, least_clearance
from ctrplan.planning.joint_space import JointSpace
from ctrplan.planning.motion import path_limits
from ctrplan.planning.play import play_shift

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.planning.scenario import Scenario

SPACING_M = 0.5e-3  # largest motion of a body point of any shape between samples
POINT_SPACING_M = 1e-3  # between the points of a shape
# More than the largest error of a tip seen on 2,500 random configurations, 0.60 mm, 98 % of them below 0.3 mm
# (`benchmarks/mechanics.py meshes --count 2500`); 0.14 mm on the certificate mesh, to which its
# last barrier adds up to 0.02 mm. Allowances, no proven bounds.
DISCRETISATION_M = {"search": 1.0e-3, "certificate": 0.2e-3}
# Friction that differs along the contact of a pair: bodies of simulated histories were at most 0.05 mm beyond those of
# all uniform states (1,632 histories, but for a fold, which is a snap).
UNEVEN_FRICTION_M = 0.05e-3
TIGHT_M = 0.1e-3  # how much less than the clearance of solved shapes is reported where nothing was found below it
SAME_BRANCH_M = 0.5e-3  # between bodies of one friction state, walked to and solved from scratch
PIECE_MM = 40.0  # joint length of the pieces that run in parallel
BENT_STEP_RAD = np.radians(2.0)  # of a joint, along which a drive with effects is taken to be straight


@dataclass(frozen=True, eq=False)
class Piece:
    """A straight part of a leg, walked; K samples."""

    leg: int
    start: Array  # (m,)
    end: Array  # (m,)
    samples: PathSamples  # fractions are of the piece
    theta_b: Array  # (K, n)
    l_b: Array  # (K, n)
    accuracy: Accuracy
    offset_m: Array  # (K,) half the motion to the neighbours, the discretisation error, uneven friction and the play
    clearance_m: Array  # (K,) less the offset: of the shapes that were solved, then of every friction state
    play_m: float  # how far play of the drive may move the robot, the largest of both ends and the middle
    branches: Array  # (K,) [m] how far bodies solved from scratch lie from those walked to, where that was looked at


def walk_pieces(
    scenario: Scenario, space: JointSpace, corners: Array, accuracy: Accuracy, progress: Progress | None
) -> list[Piece]:
    """The legs in pieces, in parallel, each from scratch: clearances are of the frictionless and the corner shapes.

    Pieces that only the coarse mesh's allowance for its error would refuse are walked on the fine mesh.
    """
    ends = []
    for leg, (a, b) in enumerate(zip(corners[:-1], corners[1:], strict=True)):
        count = max(1, int(np.ceil(space.length_mm(b - a) / PIECE_MM)))
        points = a + np.linspace(0, 1, count + 1)[:, None] * (b - a)
        ends += [(leg, points[k], points[k + 1]) for k in range(count)]
    if not ends:
        ends = [(0, corners[0], corners[0])]
    required = path_limits(scenario).clearance_m

    def walk(piece: tuple[int, Array, Array]) -> Piece:
        found = walked(scenario, space, *piece, accuracy)
        return finer(scenario, space, found) if _only_the_mesh_refuses(found, required) else found

    pieces: list[Piece] = []
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for piece in pool.map(walk, ends):
            pieces.append(piece)
            if progress:  # told by this thread alone, so that whoever listens needs no lock
                progress(len(pieces) / len(ends))
    return pieces


def walked(scenario: Scenario, space: JointSpace, leg: int, start: Array, end: Array, accuracy: Accuracy) -> Piece:
    """One piece, from joints start (m,) to end (m,)."""
    density = PathDensity(motion_m=SPACING_M, near_m=SPACING_M, point_spacing_m=POINT_SPACING_M)
    theta, l = space.drive.collars(_straight_steps(space, start, end))  # noqa: E741 (as in the equations)
    found = scenario.robot.mechanics.check_path(
        theta, l, density=density, accuracy=accuracy, bodies=bool(scenario.anatomy)
    )
    place = found.segment + found.fraction
    samples = replace(found, segment=np.zeros_like(found.segment), fraction=place / max(len(theta) - 1, 1))
    rows = np.arange(len(theta))
    theta_b, l_b = (np.column_stack([np.interp(place, rows, c) for c in part.T]) for part in (theta, l))
    ends = [start] if np.array_equal(start, end) else [start, (start + end) / 2, end]
    play = max(play_shift(scenario.robot, *space.drive.collars(q)) for q in ends)
    motion = np.maximum(samples.motion_m, np.append(samples.motion_m[1:], 0.0))  # on both sides of a sample
    offset = motion / 2 + DISCRETISATION_M[accuracy] + UNEVEN_FRICTION_M + play
    clearance = _solved_clearance(scenario, samples) - offset
    nowhere = np.zeros(len(place))
    return Piece(leg, start, end, samples, theta_b, l_b, accuracy, offset, clearance, play, nowhere)


def finer(scenario: Scenario, space: JointSpace, piece: Piece) -> Piece:
    """The same piece on the certificate mesh."""
    return walked(scenario, space, piece.leg, piece.start, piece.end, "certificate")


def in_every_friction_state(scenario: Scenario, space: JointSpace, pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces with clearances of every friction state, and without the bodies.

    Where no state is found to have less than the solved shapes of the whole path, the least clearance is that of those
    shapes less TIGHT_M.
    """
    distance, required = AnatomyDistance.of(scenario), path_limits(scenario).clearance_m
    solved = min(float(piece.clearance_m.min()) for piece in pieces)
    if distance is None or solved < required or scenario.robot.n == 1:
        return [_light(piece) for piece in pieces]
    enough = max(required, solved - TIGHT_M)

    def look(piece: Piece) -> Piece:
        found = _every_state(scenario, distance, piece, enough, required)
        if not _only_the_mesh_refuses(found, required):
            return _light(found)
        again = finer(scenario, space, piece)
        return _light(_every_state(scenario, distance, again, enough, required))

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(look, pieces))


def _straight_steps(space: JointSpace, start: Array, end: Array) -> Array:
    """(S, m) joint values between which the drive's collars may be taken to move straight."""
    if not space.drive.terms:
        return np.array([start, end])
    turned = np.abs(end - start)[space.drive.is_rotation].max(initial=0.0)
    count = max(1, int(np.ceil(turned / BENT_STEP_RAD)))
    steps: Array = start + np.linspace(0, 1, count + 1)[:, None] * (end - start)
    return steps


def _only_the_mesh_refuses(piece: Piece, required_m: float) -> bool:
    spare = DISCRETISATION_M[piece.accuracy] - DISCRETISATION_M["certificate"]
    return bool(piece.clearance_m.min() < required_m <= piece.clearance_m.min() + spare)


def _solved_clearance(scenario: Scenario, samples: PathSamples) -> Array:
    """(K,) smallest clearance of the frictionless and the corner shapes beyond the margins [m]; inf in free space."""
    distance = AnatomyDistance.of(scenario)
    if distance is None:
        return np.full(len(samples.fraction), np.inf)
    points = np.concatenate(samples.bodies)
    owner = np.repeat(np.arange(len(samples.bodies)), [len(body) for body in samples.bodies])
    return distance.least(points[:, :3], points[:, 3], owner, len(samples.bodies))


def _every_state(
    scenario: Scenario, distance: AnatomyDistance, piece: Piece, enough_m: float, required_m: float
) -> Piece:
    """Clearances down to `enough_m`; ends at the first sample that falls below `required_m`."""
    clearance, branches = piece.clearance_m.copy(), piece.branches.copy()
    for k in range(len(clearance)):
        shapes = piece.samples.bodies[k].reshape(2 ** (scenario.robot.n - 1) + 1, -1, 4)
        solver = _StateSolver(scenario, piece, k, shapes[:, :, :3])
        offset = float(piece.offset_m[k])
        found = least_clearance(solver.known(), shapes[0, :, 3], solver, distance, enough_m + offset)
        clearance[k], branches[k] = min(clearance[k], found.lower_m - offset), solver.apart_m
        if clearance[k] < required_m:
            break
    return replace(piece, clearance_m=clearance, branches=branches)


@dataclass(eq=False)
class _StateSolver:
    """Solves friction states at a sample, and compares what is solved from scratch with what was walked to."""

    scenario: Scenario
    piece: Piece
    sample: int
    bodies: Array  # (1 + C, N, 3) frictionless, corners
    apart_m: float = 0.0

    def known(self) -> dict[State, Array]:
        """Bodies of the states that were walked to."""
        pairs = self.scenario.robot.n - 1
        return dict(zip([(0.0,) * pairs, *corner_states(pairs)], self.bodies, strict=True))

    def __call__(self, phi: Array) -> Array:
        """(S, N, 3) bodies in friction states (S, P); NaN where no equilibrium was found on the same branch."""
        first = np.array(list(self.known())) if self.apart_m == 0 else np.empty((0, phi.shape[1]))
        found = self.scenario.robot.mechanics.friction_bodies(
            self.piece.theta_b[self.sample],
            self.piece.l_b[self.sample],
            np.vstack([first, phi]),
            spacing_m=POINT_SPACING_M,
            accuracy=self.piece.accuracy,
        )
        bodies = np.where(found.solved[:, None, None], found.point_m, np.nan)
        if len(first):
            apart = np.linalg.norm(bodies[: len(first)] - self.bodies, axis=2).max()
            self.apart_m = float(np.nan_to_num(apart, nan=np.inf))
        same = self.apart_m <= SAME_BRANCH_M
        return bodies[len(first) :] if same else np.full_like(bodies[len(first) :], np.nan)


def _light(piece: Piece) -> Piece:
    return replace(piece, samples=replace(piece.samples, bodies=()))
