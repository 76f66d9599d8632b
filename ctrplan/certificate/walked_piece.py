"""Pieces of legs walked densely for a certificate, and all their samples in one table.

The file's robot is walked, and beside it what the robot may be as well: the corners of what is large of stated
intervals and play, and single ends of what is small (`variants.py`). Samples are so close that no body point of any of
these moves farther between them than what is allowed for.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, alike, lengths, shares_of_length
from ctrplan.base.long_work import Progress, cores
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.certificate import CertificateSamples
from ctrplan.certificate.friction_states import (
    POINT_SPACING_M,
    SPACING_M,
    UNEVEN_FRICTION_M,
    CornerShapes,
    exact_gives_back_m,
    mesh_allowance_m,
    signed_square,
    tips_at,
)
from ctrplan.certificate.variants import (
    MOST_LARGE,
    VARIANT_SPACING_M,
    Variants,
    VariantWalks,
    walk_corners,
    walk_variants,
)
from ctrplan.drive.trajectory import driven_ways
from ctrplan.mechanics.friction import released_error
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity, PathSamples
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.prediction import start_load

if TYPE_CHECKING:
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.mechanics.shapes import Accuracy
    from ctrplan.scenario.scenario import Scenario

PIECE_MM = 40.0  # joint length of the pieces that run in parallel
FINE_M = 0.1e-3  # between samples where half of SPACING_M decides: five times the work there
LEAP_M = 2 * SPACING_M  # a shape that moves farther between samples was not followed
FROM_PLATE_M = 5e-3  # points of a body farther from where it leaves the plate have to stay in front of it


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a leg, walked; K samples."""

    leg: int
    way: Array  # (S, m) joints driven, straight in between
    joints: Array  # (K, m)
    samples: PathSamples  # of the file's robot
    theta_b: Array  # (K, n)
    l_b: Array  # (K, n)
    accuracy: Accuracy  # of the walk
    variants: Variants
    walks: VariantWalks  # of what else the robot may be
    motion_m: Array  # (K,) largest of a body point since the sample before, whatever the robot is
    allowance_m: Array  # (K,) half the motion to the neighbours and uneven friction: not that of the mesh
    nominal_m: Array  # (K,) clearance of the frictionless shape as solved; inf in free space
    as_walked_m: Array  # (K,) clearance of the solved shapes on this mesh, all allowances taken off
    clearance_m: Array  # (K,) the same, then on the certificate mesh where it matters, then of every friction state
    taken_m: Array  # (K,) how much of it what the robot may be besides took from shapes solved, small axes included
    stability: Array  # (K,) likewise
    max_strain: Array  # (K,) likewise
    height_m: Array  # (K,) least of the surface over the front plate, beyond FROM_PLATE_M; inf where there is none
    phi: Array  # (K, P + A) state in which less than in the solved shapes was found, else 0
    apart_m: float = 0.0  # how far bodies solved from scratch lay from those walked to, where that was looked at
    finer: Mapping[tuple[int, Accuracy], CornerShapes] = field(default_factory=dict)  # of samples solved closely

    @property
    def pairs(self) -> int:
        """P."""
        return int(self.l_b.shape[1]) - 1

    @property
    def play_m(self) -> Array:
        """(K,) how far play of the drive may move the tip."""
        return np.zeros(len(self.l_b)) if self.walks.play_m is None else self.walks.play_m

    @property
    def end_tips_m(self) -> tuple[Array, Array]:
        """(T, 3) tips of every shape that was walked, at the first and at the last sample."""
        first, last = (tips_at([self.samples, *self.walks.corners], row) for row in (0, -1))
        ends = self.walks.end_tips_m
        return (first, last) if ends is None else (np.vstack([first, ends[0]]), np.vstack([last, ends[1]]))

    @property
    def margins(self) -> tuple[Array, Array]:
        """(K,), (K,) least stability and largest strain of whatever the robot is."""
        softer, strained = (0.0 if part is None else part for part in (self.walks.softer, self.walks.strain))
        square = signed_square(self.stability) - softer
        return np.sign(square) * np.sqrt(np.abs(square)), self.max_strain + strained

    def offset_m(self, scenario: Scenario, accuracy: Accuracy) -> Array:
        """(K,) all that is taken off clearances of shapes solved at an accuracy."""
        return self.allowance_m + mesh_allowance_m(scenario.robot, accuracy)

    @property
    def added_up_m(self) -> Array:
        """(K,) the largest sum of lengths that is taken off for small axes; zeros if there is none."""
        if not self.walks.reach_m or not self.variants.small:
            return np.zeros(len(self.l_b))
        return np.array([reach.max() for reach in self.walks.reach_m]) - self.variants.base.shift_m

    def light(self) -> Piece:
        """Without the shapes."""
        corners = tuple(replace(walk, bodies=()) for walk in self.walks.corners)
        return replace(
            self,
            samples=replace(self.samples, bodies=()),
            walks=replace(self.walks, corners=corners, reach_m=()),
            finer={},
        )

    @property
    def scenario(self) -> Scenario:
        """The scenario whose robot walks the piece."""
        return self.variants.scenario

    def shapes(self, sample: int) -> CornerShapes:
        """The frictionless shape, and those in corners of friction and of the large axes, as they were walked."""
        return composed(self.scenario, [(walk, sample) for walk in (self.samples, *self.walks.corners)], self, sample)


def composed(scenario: Scenario, rows: Sequence[tuple[PathSamples, int]], piece: Piece, sample: int) -> CornerShapes:
    """The shapes of a sample from rows of walks: of the file's robot, then of every corner of the large axes."""
    own, radius = shapes_of(scenario, rows[0][0].bodies[rows[0][1]])
    bodies = [alike(shapes_of(scenario, walk.bodies[row])[0], own[0]) for walk, row in rows]
    stability = [walk.shape_stability[row] for walk, row in rows]
    strain = [walk.shape_max_strain[row] for walk, row in rows]
    corners = slice(1 if len(rows) > 1 else 0, None)
    filled = filled_radius(radius, own[0], piece, sample)

    def joined(parts: Sequence[Array]) -> Array:
        """Friction states first, then the large axes, the last of them fastest."""
        states = np.stack([part[1:] for part in parts[corners]], axis=1)
        return np.concatenate([parts[0][:1], states.reshape(-1, *states.shape[2:])])

    return CornerShapes(joined(bodies), joined(stability), joined(strain), filled)


def filled_radius(radius_m: Array, body_m: Array, piece: Piece | None, sample: int) -> Array:
    """(N,) outer radii of a body (N, 3), and how far small axes and base may move its points: a neighbour's if more."""
    if piece is None or not piece.walks.reach_m:
        return radius_m
    return np.asarray(radius_m + reach_on(body_m, piece.walks, sample))


def reach_on(body_m: Array, walks: VariantWalks, sample: int) -> Array:
    """(N,) [m] the reach of a sample on a body (N, 3): of neighbouring points the larger."""
    reach = walks.reach_m[sample]
    if len(reach) != len(body_m):
        reach = np.interp(shares_of_length(body_m), np.linspace(0, 1, len(reach)), reach)
    return np.asarray(np.maximum(reach, np.maximum(np.append(reach[1:], reach[-1]), np.append(reach[0], reach[:-1]))))


def walk_pieces(
    scenario: Scenario,
    space: JointSpace,
    corners: Array,
    accuracy: Accuracy,
    progress: Progress | None,
    known: Sequence[Piece] = (),
    timing: Trajectory | None = None,
    large: tuple[int, ...] | None = None,
    most_large: int = MOST_LARGE[0],
) -> list[Piece]:
    """The legs in pieces, in parallel, each from scratch: of the frictionless and the corner shapes.

    Those that are among the `known` ones of the same scenario, as they were walked, are not walked again. `large` says
    which axes of what the robot may be are looked at in cells, else the `most_large` that move the tip most are.
    """
    memory = {(piece.way.tobytes(), piece.variants.large, piece.accuracy): piece for piece in known}
    ways = _cut(space, driven_ways(scenario.robot.drive, corners, timing))
    variants = Variants.of(scenario, np.concatenate([way for _, way in ways]), large, most_large)

    def walk(leg_way: tuple[int, Array]) -> Piece:
        leg, way = leg_way
        keys = [(way.tobytes(), variants.large, mesh) for mesh in (accuracy, "certificate")]
        piece = next(filter(None, map(memory.get, keys)), None) or walked(variants, space, leg, way, accuracy)
        leaps = piece.motion_m.max() > LEAP_M and piece.samples.status[-1] < Status.UNSTABLE
        if leaps and piece.accuracy != "certificate":  # whose nodes are others: on one mesh these may leap alone
            return walked(variants, space, leg, way, "certificate")
        return replace(piece, leg=leg)

    pieces: list[Piece] = []
    with ThreadPoolExecutor(cores()) as pool:
        for piece in pool.map(walk, ways):
            pieces.append(piece)
            if progress:  # told by this thread alone, so that whoever listens needs no lock
                progress(len(pieces) / len(ways))
    return pieces


def _cut(space: JointSpace, ways: Sequence[tuple[int, Array]]) -> list[tuple[int, Array]]:
    """Ways (S, m) of legs in parts of about PIECE_MM of joint length."""
    results: list[tuple[int, Array]] = []
    for leg, way in ways:
        lengths_mm = np.append(0.0, np.cumsum(space.lengths_mm(np.diff(way, axis=0))))
        count = max(1, int(np.ceil(lengths_mm[-1] / PIECE_MM - 1e-9)))
        at = np.linspace(0, lengths_mm[-1], count + 1)
        ends = [_at(lengths_mm, way, float(mm)) for mm in at]
        ends[0], ends[-1] = way[0], way[-1]
        for k in range(count):
            between = way[(lengths_mm > at[k] + 1e-9) & (lengths_mm < at[k + 1] - 1e-9)]
            results.append((leg, np.vstack([ends[k], between, ends[k + 1]])))
    return results


def _at(place: Array, rows: Array, where: Array | float) -> Array:
    """Rows (S, c) at places (S,), interpolated where it is asked for."""
    return np.array([np.interp(where, place, column) for column in rows.T]).T


def _joints(rows: Array, samples: PathSamples) -> Array:
    """(K, m) joints at samples of a walk along rows (S, m); exact at the rows."""
    if len(rows) == 1:
        return np.repeat(rows, len(samples.fraction), axis=0)
    begin, end = rows[samples.segment], rows[np.minimum(samples.segment + 1, len(rows) - 1)]
    share = samples.fraction[:, None]
    return np.where(share == 1, end, begin + share * (end - begin))


def walked_finely(
    pieces: Sequence[Piece], as_walked: Sequence[Piece], limit_m: float, space: JointSpace
) -> list[Piece] | None:
    """Pieces as they were walked, anew with FINE_M between samples where clearances lack what that gives back.

    None where no clearance is below the limit, or where shorter steps cannot help.
    """
    results = list[Piece]()
    for piece, before in zip(pieces, as_walked, strict=True):
        short = np.flatnonzero(piece.clearance_m < limit_m)
        given_back = piece.allowance_m - UNEVEN_FRICTION_M - FINE_M / 2 + exact_gives_back_m(piece.scenario.robot)
        if (piece.clearance_m[short] + given_back[short] < limit_m).any():
            return None
        if not len(short):
            results.append(before)
            continue
        way_mm, at_mm = (
            np.append(0.0, np.cumsum(space.lengths_mm(np.diff(rows, axis=0)))) for rows in (piece.way, piece.joints)
        )
        first, last = max(int(short[0]) - 1, 0), min(int(short[-1]) + 1, len(at_mm) - 1)
        cuts = np.unique([0.0, at_mm[first], at_mm[last], at_mm[-1]])
        for a, b in itertools.pairwise(cuts.tolist()):
            between = piece.way[(way_mm > a + 1e-9) & (way_mm < b - 1e-9)]
            ends = [piece.joints[int(np.searchsorted(at_mm, mm))] for mm in (a, b)]
            part, is_fine = np.vstack([ends[0], between, ends[1]]), a == at_mm[first]
            spacing_m = FINE_M if is_fine else SPACING_M
            results.append(walked(piece.variants, space, piece.leg, part, piece.accuracy, spacing_m))
    return None if all(piece in as_walked for piece in results) else results


def walked(
    variants: Variants, space: JointSpace, leg: int, way: Array, accuracy: Accuracy, spacing_m: float = SPACING_M
) -> Piece:
    """One piece, along the joints of a way (S, m)."""
    scenario, mechanics = variants.scenario, variants.scenario.robot.mechanics
    density = PathDensity(motion_m=spacing_m, near_m=spacing_m, point_spacing_m=POINT_SPACING_M)
    rows = variants.straight_steps(way)
    samples = mechanics.check_path(*space.drive.collars(rows), density=density, accuracy=accuracy, bodies=True)
    joints, corners = _joints(rows, samples), list[PathSamples]()
    if variants.large and samples.status[-1] < Status.UNSTABLE:
        corners, finer = walk_corners(variants, joints, accuracy)
        if len(finer) > len(joints):  # the file's robot and all corners once more, at the samples of any
            wider = replace(density, motion_m=VARIANT_SPACING_M, near_m=VARIANT_SPACING_M)
            again = mechanics.check_path(*space.drive.collars(finer), density=wider, accuracy=accuracy, bodies=True)
            if (at_rows := again.at_given(len(finer))) is not None:
                samples, joints = at_rows, finer
                corners, _ = walk_corners(variants, joints, accuracy)
    theta_b, l_b = space.drive.collars(joints)
    place = np.append(0.0, np.cumsum(space.lengths_mm(np.diff(joints, axis=0))))
    whole = samples.segment[-1] + samples.fraction[-1] >= len(rows) - 1 or np.array_equal(joints[-1], way[-1])
    share = place / place[-1] if place[-1] > 0 else np.linspace(0, 1, len(place))
    samples = replace(
        samples, segment=np.zeros_like(samples.segment), fraction=share if whole else np.minimum(share, 1 - 1e-9)
    )
    shapes = [shapes_of(scenario, body) for body in samples.bodies]
    walks = VariantWalks()
    if whole and samples.status[-1] < Status.UNSTABLE:
        walks = walk_variants(variants, joints, samples, [bodies[0] for bodies, _ in shapes], corners, accuracy)
    moved = np.max([samples.motion_m, *(walk.motion_m for walk in walks.corners)], axis=0)
    motion = np.maximum(moved, np.append(moved[1:], 0.0))  # on both sides of a sample
    allowance = motion / 2 + UNEVEN_FRICTION_M
    nominal, bare, solved = _solved_clearances(scenario, samples, walks)
    as_walked = solved - allowance - mesh_allowance_m(scenario.robot, accuracy)
    every = [samples, *walks.corners]
    return Piece(
        leg=leg,
        way=way,
        joints=joints,
        samples=samples,
        theta_b=theta_b,
        l_b=l_b,
        accuracy=accuracy,
        variants=variants,
        walks=walks,
        motion_m=moved,
        allowance_m=allowance,
        nominal_m=nominal,
        as_walked_m=as_walked,
        clearance_m=as_walked,
        taken_m=np.where(np.isfinite(bare), bare - np.where(np.isfinite(bare), solved, 0.0), 0.0),
        stability=np.min([np.nan_to_num(w.shape_stability, nan=-np.inf).min(axis=1) for w in every], axis=0),
        max_strain=np.max([w.max_strain for w in every], axis=0),
        height_m=np.array([_height(scenario, every, walks, k) for k in range(len(joints))]),
        phi=np.zeros((len(place), scenario.robot.n - 1 + len(variants.large))),
    )


def _solved_clearances(scenario: Scenario, samples: PathSamples, walks: VariantWalks) -> tuple[Array, Array, Array]:
    """(K,) of the frictionless shape, of all shapes of the file's robot, and of all that it may be [m].

    Beyond the margins; inf in free space.
    """
    distance, count = AnatomyDistance.of(scenario), len(samples.bodies)
    if distance is None:
        return np.full(count, np.inf), np.full(count, np.inf), np.full(count, np.inf)
    points = np.concatenate(samples.bodies)
    owner = np.concatenate([_groups(len(body), 2 * k, scenario.robot.n) for k, body in enumerate(samples.bodies)])
    least = distance.as_registered.least(points[:, :3], points[:, 3], owner, 2 * count)
    nominal, bare = least[::2], least.reshape(-1, 2).min(axis=1)
    if not walks.reach_m:
        return nominal, bare, bare
    every = np.full(count, np.inf)
    shapes = 2 ** (scenario.robot.n - 1) + 1
    for walk in (samples, *walks.corners):
        radii = []
        for k, body in enumerate(walk.bodies):
            own = body[: len(body) // shapes]
            radii.append(np.tile(own[:, 3] + reach_on(own[:, :3], walks, k), shapes))
        body_owner = np.repeat(np.arange(count), [len(body) for body in walk.bodies])
        points = np.concatenate(walk.bodies)[:, :3]
        every = np.minimum(every, distance.least(points, np.concatenate(radii), body_owner, count))
    return nominal, bare, every


def _groups(points: int, first: int, tubes: int) -> NDArray[np.intp]:
    """(N,) owners of a sample's points: the frictionless shape is `first`, all corners are the next."""
    of_one = points // (2 ** (tubes - 1) + 1)
    groups = np.full(points, first + 1, dtype=np.intp)
    groups[:of_one] = first
    return groups


def _height(scenario: Scenario, every: Sequence[PathSamples], walks: VariantWalks, sample: int) -> float:
    """Least [m] of the surface over the plate, where a sample's body has left it by more than FROM_PLATE_M."""
    least = np.inf
    for walk in every:
        bodies, radius = shapes_of(scenario, walk.bodies[sample])
        along = np.gradient(bodies, axis=1)
        beside = radius * lengths(along[..., :2]) / np.maximum(lengths(along), np.finfo(float).tiny)
        reach = reach_on(bodies[0], walks, sample) if walks.reach_m else 0.0
        beyond = lengths(bodies) - reach > FROM_PLATE_M
        least = min(least, float((bodies[..., 2] - beside - reach)[beyond].min(initial=np.inf)))
    return least


def shapes_of(scenario: Scenario, body: Array) -> tuple[Array, Array]:
    """(1 + C, N, 3) points of the frictionless and the corner shapes of a sample, and their outer radii (N,)."""
    shapes = body.reshape(2 ** (scenario.robot.n - 1) + 1, -1, 4)
    return shapes[:, :, :3], shapes[0, :, 3]


def narrowest_of(pieces: Sequence[Piece]) -> float:
    """Smallest clearance of pieces [m]."""
    return min(float(piece.clearance_m.min()) for piece in pieces)


def joined_samples(scenario: Scenario, space: JointSpace, pieces: Sequence[Piece]) -> CertificateSamples:
    """One table over all pieces; the first sample of every piece but the first repeats the last one before it."""
    travelled = 0.0
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in CertificateSamples.__dataclass_fields__}
    load = start_load(scenario)
    for number, piece in enumerate(pieces):
        s, count = piece.samples, len(piece.joints)
        keep = slice(0 if number == 0 else 1, None)
        loads = _loads_left(piece, space, load)
        load = loads[-1]
        path_mm = travelled + np.append(0.0, np.cumsum(space.lengths_mm(np.diff(piece.joints, axis=0))))
        travelled = float(path_mm[-1])
        stability, strain = piece.margins
        bound = np.zeros(count) if piece.walks.bound_m is None else piece.walks.bound_m
        rows: dict[str, NDArray[Any]] = {
            "leg": np.full(count, piece.leg),
            "joints": piece.joints,
            "path_mm": path_mm,
            "bound_m": s.position_m + bound,
            "bound_rad": s.tangent_rad,
            "stability": stability,
            "max_strain": strain,
            "clearance_m": piece.clearance_m,
            "motion_m": piece.motion_m,
            "tip_m": s.tip_m,
            "released_m": released_error(s, loads),
            "predicted_m": s.position_m,  # until it is simulated
            "play_m": piece.play_m,
            "parameter_bound_m": bound,
            "parameter_clearance_m": piece.taken_m,
            "parameter_stability": s.shape_stability.min(axis=1) - stability,
            "parameter_strain": strain - s.max_strain,
            "spread_m": s.position_m,  # until it is simulated
            "friction_spread": np.ones((count, scenario.robot.n - 1)),
        }
        for name, values in rows.items():
            columns[name].append(values[keep])
    return CertificateSamples(**{name: np.concatenate(parts) for name, parts in columns.items()})


def _loads_left(piece: Piece, space: JointSpace, load: Array) -> Array:
    """(K, P) largest |phi| possible at the samples, given the largest possible at the first (P,)."""
    law = friction_law(piece.scenario.robot)
    if len(piece.way) == 2:
        return law.load_left(load, *space.drive.collars(piece.way), piece.samples.fraction)
    theta, l = space.drive.collars(piece.joints)  # noqa: E741 (as in the equations)
    loads = [np.minimum(load, 1.0)]
    for k in range(1, len(theta)):
        loads.append(law.load_left(loads[-1], theta[k - 1 : k + 1], l[k - 1 : k + 1], np.ones(1))[0])
    return np.array(loads)


def checked_samples(samples: CertificateSamples, pieces: list[Piece]) -> CertificateSamples:
    """The table with what a closer look at the pieces found to be left."""

    def column(parts: Iterable[Array]) -> Array:
        return np.concatenate([part[number > 0 :] for number, part in enumerate(parts)])

    return replace(
        samples,
        clearance_m=column(piece.clearance_m for piece in pieces),
        stability=column(piece.margins[0] for piece in pieces),
        max_strain=column(piece.margins[1] for piece in pieces),
        parameter_clearance_m=column(piece.taken_m for piece in pieces),
    )
