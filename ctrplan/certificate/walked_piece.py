"""Pieces of legs walked densely for a certificate, the narrowest samples solved on its mesh, all samples in one
table.

Pieces are walked on the mesh of the search, whose allowance may take too much from a clearance. Samples one after the
other are walked to as pieces are, the first of them from scratch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, lengths
from ctrplan.base.long_work import Progress, cores
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.certificate import CertificateSamples
from ctrplan.certificate.friction_states import (
    POINT_SPACING_M,
    SAME_BRANCH_M,
    SPACING_M,
    UNEVEN_FRICTION_M,
    CornerShapes,
    mesh_allowance_m,
)
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity, PathSamples
from ctrplan.motion.checker import path_limits, released_error
from ctrplan.motion.play import play_reach
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.prediction import start_load

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import Accuracy
    from ctrplan.scenario.scenario import Scenario

PIECE_MM = 40.0  # joint length of the pieces that run in parallel
BENT_STEP_RAD = np.radians(2.0)  # of a joint, along which a drive with effects is taken to be straight
FROM_PLATE_M = 5e-3  # points of a body farther from where it leaves the plate have to stay in front of it


@dataclass(frozen=True, eq=False)
class Piece:
    """A straight part of a leg, walked; K samples."""

    leg: int
    start: Array  # (m,)
    end: Array  # (m,)
    samples: PathSamples  # fractions are of the piece
    theta_b: Array  # (K, n)
    l_b: Array  # (K, n)
    accuracy: Accuracy  # of the walk
    allowance_m: Array  # (K,) half the motion to the neighbours, uneven friction and play: not that of the mesh
    nominal_m: Array  # (K,) clearance of the frictionless shape as solved; inf in free space
    as_walked_m: Array  # (K,) clearance of the solved shapes on this mesh, all allowances taken off
    clearance_m: Array  # (K,) the same, then on the certificate mesh where it matters, then of every friction state
    stability: Array  # (K,) likewise
    max_strain: Array  # (K,) likewise
    height_m: Array  # (K,) least of a body point over the front plate, beyond FROM_PLATE_M; inf where there is none
    phi: Array  # (K, P) friction state in which less than in the solved shapes was found, else 0
    play_m: float  # how far play of the drive may move the robot, the largest of both ends and the middle
    apart_m: float = 0.0  # how far bodies solved from scratch lay from those walked to, where that was looked at
    finer: Mapping[int, CornerShapes] = field(
        default_factory=dict
    )  # on the certificate mesh, of samples solved closely

    def offset_m(self, scenario: Scenario, accuracy: Accuracy) -> Array:
        """(K,) all that is taken off clearances of shapes solved at an accuracy."""
        return self.allowance_m + mesh_allowance_m(scenario.robot, accuracy)

    def light(self) -> Piece:
        """Without the shapes."""
        return replace(self, samples=replace(self.samples, bodies=()), finer={})


def walk_pieces(
    scenario: Scenario,
    space: JointSpace,
    corners: Array,
    accuracy: Accuracy,
    progress: Progress | None,
    known: Sequence[Piece] = (),
) -> list[Piece]:
    """The legs in pieces, in parallel, each from scratch: of the frictionless and the corner shapes.

    Those that are among the `known` ones of the same scenario, as they were walked, are not walked again.
    """
    memory = {(piece.start.tobytes(), piece.end.tobytes(), piece.accuracy): piece for piece in known}
    ends: list[tuple[int, Array, Array]] = []
    for leg, (a, b) in enumerate(zip(corners[:-1], corners[1:], strict=True)):
        count = max(1, int(np.ceil(space.length_mm(b - a) / PIECE_MM)))
        points = a + np.linspace(0, 1, count + 1)[:, None] * (b - a)
        ends += [(leg, points[k], points[k + 1]) for k in range(count)]
    if not ends:
        ends = [(0, corners[0], corners[0])]

    def walk(end: tuple[int, Array, Array]) -> Piece:
        leg, a, b = end
        same = memory.get((a.tobytes(), b.tobytes(), accuracy))
        return replace(same, leg=leg) if same else walked(scenario, space, leg, a, b, accuracy)

    pieces: list[Piece] = []
    with ThreadPoolExecutor(cores()) as pool:
        for piece in pool.map(walk, ends):
            pieces.append(piece)
            if progress:  # told by this thread alone, so that whoever listens needs no lock
                progress(len(pieces) / len(ends))
    return pieces


def walked(scenario: Scenario, space: JointSpace, leg: int, start: Array, end: Array, accuracy: Accuracy) -> Piece:
    """One piece, from joints start (m,) to end (m,)."""
    density = PathDensity(motion_m=SPACING_M, near_m=SPACING_M, point_spacing_m=POINT_SPACING_M)
    theta, l = space.drive.collars(_straight_steps(space, start, end))  # noqa: E741 (as in the equations)
    result = scenario.robot.mechanics.check_path(theta, l, density=density, accuracy=accuracy, bodies=True)
    place = result.segment + result.fraction
    samples = replace(result, segment=np.zeros_like(result.segment), fraction=place / max(len(theta) - 1, 1))
    rows = np.arange(len(theta))
    theta_b, l_b = (np.column_stack([np.interp(place, rows, c) for c in part.T]) for part in (theta, l))
    places = [start] if np.array_equal(start, end) else [start, (start + end) / 2, end]
    play = max(play_reach(scenario.robot, *space.drive.collars(q)) for q in places)
    motion = np.maximum(samples.motion_m, np.append(samples.motion_m[1:], 0.0))  # on both sides of a sample
    allowance = motion / 2 + UNEVEN_FRICTION_M + play
    nominal, solved = _solved_clearances(scenario, samples)
    as_walked = solved - allowance - mesh_allowance_m(scenario.robot, accuracy)
    return Piece(
        leg=leg,
        start=start,
        end=end,
        samples=samples,
        theta_b=theta_b,
        l_b=l_b,
        accuracy=accuracy,
        allowance_m=allowance,
        nominal_m=nominal,
        as_walked_m=as_walked,
        clearance_m=as_walked,
        stability=np.nan_to_num(samples.shape_stability, nan=-np.inf).min(axis=1),
        max_strain=samples.max_strain,
        height_m=np.array([_height(body) for body in samples.bodies]),
        phi=np.zeros((len(place), scenario.robot.n - 1)),
        play_m=play,
    )


def _straight_steps(space: JointSpace, start: Array, end: Array) -> Array:
    """(S, m) joint values between which the drive's collars may be taken to move straight."""
    if not space.drive.terms:
        return np.array([start, end])
    turned = np.abs(end - start)[space.drive.is_rotation].max(initial=0.0)
    count = max(1, int(np.ceil(turned / BENT_STEP_RAD)))
    steps: Array = start + np.linspace(0, 1, count + 1)[:, None] * (end - start)
    return steps


def _solved_clearances(scenario: Scenario, samples: PathSamples) -> tuple[Array, Array]:
    """(K,) of the frictionless shape, (K,) of all solved shapes, beyond the margins [m]; inf in free space."""
    distance, count = AnatomyDistance.of(scenario), len(samples.bodies)
    if distance is None:
        return np.full(count, np.inf), np.full(count, np.inf)
    points = np.concatenate(samples.bodies)
    owner = np.concatenate([_groups(len(body), 2 * k, scenario.robot.n) for k, body in enumerate(samples.bodies)])
    least = distance.least(points[:, :3], points[:, 3], owner, 2 * count)
    return least[::2], least.reshape(-1, 2).min(axis=1)


def _groups(points: int, first: int, tubes: int) -> NDArray[np.intp]:
    """(N,) owners of a sample's points: the frictionless shape is `first`, all corners are the next."""
    of_one = points // (2 ** (tubes - 1) + 1)
    groups = np.full(points, first + 1, dtype=np.intp)
    groups[:of_one] = first
    return groups


def _height(body: Array) -> float:
    """Least [m] of points (N, 4) over the plate of those that have left it by more than FROM_PLATE_M."""
    beyond = lengths(body[:, :3]) > FROM_PLATE_M
    return float(body[beyond, 2].min(initial=np.inf))


def shapes_of(scenario: Scenario, body: Array) -> tuple[Array, Array]:
    """(1 + C, N, 3) points of the frictionless and the corner shapes of a sample, and their outer radii (N,)."""
    shapes = body.reshape(2 ** (scenario.robot.n - 1) + 1, -1, 4)
    return shapes[:, :, :3], shapes[0, :, 3]


def narrowest_of(pieces: Sequence[Piece]) -> float:
    """Smallest clearance of pieces [m]."""
    return min(float(piece.clearance_m.min()) for piece in pieces)


def joined_samples(scenario: Scenario, space: JointSpace, corners: Array, pieces: list[Piece]) -> CertificateSamples:
    """One table over all pieces; the first sample of every piece but the first repeats the last one before it."""
    starts = np.append(0.0, np.cumsum(space.lengths_mm(np.diff(corners, axis=0))))
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in CertificateSamples.__dataclass_fields__}
    load = start_load(scenario)
    for number, piece in enumerate(pieces):
        s = piece.samples
        keep = slice(0 if number == 0 else 1, None)
        joints = piece.start + s.fraction[:, None] * (piece.end - piece.start)
        ends = space.drive.collars(np.array([piece.start, piece.end]))
        loads = friction_law(scenario.robot).load_left(load, *ends, s.fraction)
        load = loads[-1]
        rows: dict[str, NDArray[Any]] = {
            "leg": np.full(len(s.fraction), piece.leg),
            "joints": joints,
            "path_mm": starts[piece.leg] + space.lengths_mm(joints - corners[piece.leg]),
            "bound_m": s.position_m,
            "bound_rad": s.tangent_rad,
            "stability": piece.stability,
            "max_strain": piece.max_strain,
            "clearance_m": piece.clearance_m,
            "motion_m": s.motion_m,
            "tip_m": s.tip_m,
            "released_m": released_error(s, loads),
            "predicted_m": s.position_m,  # until it is simulated
            "play_m": np.full(len(s.fraction), piece.play_m),
            "parameter_bound_m": np.zeros(len(s.fraction)),  # until they are allowed for
            "parameter_clearance_m": np.zeros(len(s.fraction)),
            "parameter_stability": np.zeros(len(s.fraction)),
            "parameter_strain": np.zeros(len(s.fraction)),
            "spread_m": s.position_m,  # until it is simulated
            "friction_spread": np.ones((len(s.fraction), scenario.robot.n - 1)),
        }
        for name, values in rows.items():
            columns[name].append(values[keep])
    return CertificateSamples(**{name: np.concatenate(parts) for name, parts in columns.items()})


def checked_samples(samples: CertificateSamples, pieces: list[Piece]) -> CertificateSamples:
    """The table with what a closer look at the pieces found to be left."""

    def column(name: str) -> Array:
        return np.concatenate([getattr(piece, name)[number > 0 :] for number, piece in enumerate(pieces)])

    return replace(
        samples,
        clearance_m=column("clearance_m"),
        stability=column("stability"),
        max_strain=column("max_strain"),
    )


FIRST = 4  # narrowest samples: no others than those that seem to have less have to be solved
LONGEST = 12  # samples that one thread walks to
ONLY_THESE = PathDensity(near_m=20e-3, point_spacing_m=POINT_SPACING_M)  # samples; more only where shapes leap

Run = tuple[int, list[int]]  # piece, samples one after the other


def closely_solved(scenario: Scenario, pieces: Sequence[Piece], spare_m: float) -> list[Piece]:
    """The narrowest samples solved on the certificate mesh: all for which the search mesh shows less than is left.

    So the least clearance does not depend on the mesh that a sample happened to be walked on, unless it is more than
    `spare_m` beyond the limit.
    """
    distance, limits = AnatomyDistance.of(scenario), path_limits(scenario)
    if distance is None or spare_m < 0:
        return list(pieces)
    closer = [piece.clearance_m.copy() for piece in pieces]
    finer: list[dict[int, CornerShapes]] = [{} for _ in pieces]
    rows = sorted((float(c), p, k) for p, piece in enumerate(pieces) for k, c in enumerate(piece.clearance_m))
    narrow = [row for row in rows if pieces[row[1]].accuracy == "search"]
    ceiling = limits.clearance_m + spare_m  # of the least clearance that is asked for
    with ThreadPoolExecutor(cores()) as pool:
        for some in (narrow[:FIRST], narrow[FIRST:]):
            runs = _runs([(p, k) for value, p, k in some if value < ceiling])
            solved = pool.map(lambda run: _on_certificate_mesh(scenario, distance, pieces[run[0]], run[1]), runs)
            for (p, samples), result in zip(runs, solved, strict=True):
                for k, (clearance, shapes) in zip(samples, result, strict=True):
                    closer[p][k] = max(closer[p][k], clearance)
                    ceiling = min(ceiling, closer[p][k])
                    if shapes:
                        finer[p][k] = shapes
    changed = zip(pieces, closer, finer, strict=True)
    return [replace(piece, clearance_m=values, finer=shapes) for piece, values, shapes in changed]


def _runs(places: Sequence[tuple[int, int]]) -> list[Run]:
    """Pieces and samples as runs of samples one after the other, none longer than LONGEST."""
    results = list[Run]()
    for (piece, _), of_run in groupby(enumerate(sorted(places)), lambda row: (row[1][0], row[1][1] - row[0])):
        samples = [k for _, (_, k) in of_run]
        results += [(piece, samples[i : i + LONGEST]) for i in range(0, len(samples), LONGEST)]
    return results


def _on_certificate_mesh(
    scenario: Scenario, distance: AnatomyDistance, piece: Piece, samples: Sequence[int]
) -> list[tuple[float, CornerShapes | None]]:
    """Clearance of each sample's solved shapes, all allowances taken off, and these; -inf on another branch."""
    result = scenario.robot.mechanics.check_path(
        piece.theta_b[samples], piece.l_b[samples], density=ONLY_THESE, accuracy="certificate", bodies=True
    )
    offset, nothing = piece.offset_m(scenario, "certificate"), (-np.inf, None)
    solved: list[tuple[float, CornerShapes | None]] = [nothing] * len(samples)
    is_asked = (result.fraction == 1) | (np.arange(len(result.fraction)) == 0)
    for row in np.flatnonzero(is_asked & (result.status != Status.FAILED)):
        at = int(result.segment[row] + result.fraction[row])
        bodies, radius = shapes_of(scenario, result.bodies[row])
        if _apart_m(scenario, piece, samples[at], bodies) > SAME_BRANCH_M:
            continue
        shapes = CornerShapes(bodies, result.shape_stability[row], result.shape_max_strain[row], radius)
        owner = np.zeros(bodies.shape[0] * bodies.shape[1], dtype=np.intp)
        least = distance.least(bodies.reshape(-1, 3), np.tile(radius, len(bodies)), owner, 1)[0]
        solved[at] = float(least) - float(offset[samples[at]]), shapes
    return solved


def _apart_m(scenario: Scenario, piece: Piece, sample: int, bodies: Array) -> float:
    """How far tips of shapes (1 + C, N, 3) lie from those that were walked to, beyond what meshes differ by."""
    walked = shapes_of(scenario, piece.samples.bodies[sample])[0]
    apart = np.linalg.norm(bodies[:, -1] - walked[:, -1], axis=1)
    return float(np.nan_to_num(apart.max(), nan=np.inf)) - mesh_allowance_m(scenario.robot, piece.accuracy)
