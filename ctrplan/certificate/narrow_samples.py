"""Samples of walked pieces that decide, solved more closely: on finer meshes and at the ends of what is first order.

Pieces are walked on the mesh of the search, whose allowance may take too much from a clearance; so may that of the
certificate mesh, most of which is first order in the clearance between tubes, where little is left. Samples one after
the other are walked to as pieces are, the first of them from scratch.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array, alike, lengths
from ctrplan.base.long_work import cores
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.friction_states import (
    POINT_SPACING_M,
    CornerShapes,
    corner_states,
    exact_gives_back_m,
    mesh_allowance_m,
)
from ctrplan.certificate.variants import NO_EQUILIBRIUM
from ctrplan.certificate.walked_piece import Piece, composed, shapes_of
from ctrplan.errors import CtrplanError
from ctrplan.mechanics.equilibria import SAME_SHAPE_M
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity, PathSamples
from ctrplan.motion.limits import path_limits
from ctrplan.uncertainty.body_clearance import GRADIENT_STEP_M

if TYPE_CHECKING:
    from ctrplan.certificate.friction_cube import StateMinima
    from ctrplan.mechanics.shapes import Accuracy
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

NARROWEST = 4  # samples that are solved first: of others only those that seem to have less, a budget
LONGEST = 12  # samples that one thread walks to
ONLY_THESE = PathDensity(near_m=20e-3, point_spacing_m=POINT_SPACING_M)  # samples; more only where shapes leap

Run = tuple[int, list[int]]  # piece, samples one after the other
Closely = list[tuple[float, CornerShapes | None]]  # clearance and shapes of samples


@dataclass
class CloserLooks:
    """What closer looks at pieces found, by `key_of`, for the paths of one plan that share them."""

    closely: dict[Hashable, Closely] = field(default_factory=dict)  # by the samples, too
    minima: dict[Hashable, dict[int, tuple[float, StateMinima]]] = field(default_factory=dict)  # clearance asked for


_LOOKS: ContextVar[CloserLooks | None] = ContextVar("closer looks", default=None)


@contextmanager
def remembered_looks() -> Iterator[None]:
    """Within, in this context, pieces that were looked at closely for one path are not looked at again for another.

    For all paths of one plan: of the same robot, anatomy and margins.
    """
    token = _LOOKS.set(CloserLooks())
    try:
        yield
    finally:
        _LOOKS.reset(token)


def closer_looks(spare_m: float) -> CloserLooks:
    """What is remembered in this context; nothing where no path shares it, or where all clearance is asked for.

    How closely a sample was looked at depends on what other paths asked of it. A certificate that is written says what
    anybody computes who certifies the path alone.
    """
    return (_LOOKS.get() if np.isfinite(spare_m) else None) or CloserLooks()


def key_of(piece: Piece) -> Hashable:
    """Alike for pieces with the same samples; of the same variants, as pieces that are not walked again."""
    ways = piece.joints.tobytes(), piece.way.tobytes()
    return piece.scenario.robot, *ways, piece.accuracy, piece.variants.large


def closely_solved(scenario: Scenario, pieces: Sequence[Piece], spare_m: float, more_m: float = 0.0) -> list[Piece]:
    """The narrowest samples solved on the certificate mesh: all for which the search mesh shows less than is left.

    So the least clearance does not depend on the mesh that a sample happened to be walked on, unless it is more than
    `spare_m` beyond the limit, which is `more_m` above the scenario's. Samples that lack no more than the mesh's own
    allowance are solved with exact geometry.
    """
    distance, limit_m = AnatomyDistance.of(scenario), path_limits(scenario).clearance_m + more_m
    if distance is None or spare_m < 0:
        return list(pieces)
    closer = [piece.clearance_m.copy() for piece in pieces]
    finer: list[dict[tuple[int, Accuracy], CornerShapes]] = [{} for _ in pieces]
    rows = sorted((float(c), p, k) for p, piece in enumerate(pieces) for k, c in enumerate(piece.clearance_m))
    narrow = [row for row in rows if pieces[row[1]].accuracy == "search"]
    ceiling = limit_m + spare_m  # of the least clearance that is asked for
    known = closer_looks(spare_m)

    def solve(accuracy: Accuracy, run: Run) -> Closely:
        piece, samples = pieces[run[0]], run[1]
        key = key_of(piece), tuple(samples), accuracy
        if key not in known.closely:
            known.closely[key] = _solved_anew(scenario, distance, piece, samples, accuracy)
        return known.closely[key]

    def look(places: Sequence[tuple[int, int]], accuracy: Accuracy) -> float:
        """Solves these samples; the least clearance that is left at any of them."""
        runs = _runs(places)
        for (p, samples), result in zip(runs, pool.map(partial(solve, accuracy), runs), strict=True):
            for k, (clearance, shapes) in zip(samples, result, strict=True):
                closer[p][k] = max(closer[p][k], clearance)
                if shapes:
                    finer[p][k, accuracy] = shapes
        return min((float(closer[p][k]) for p, k in places), default=np.inf)

    with ThreadPoolExecutor(cores()) as pool:
        for some in (narrow[:NARROWEST], narrow[NARROWEST:]):
            ceiling = min(ceiling, look([(p, k) for value, p, k in some if value < ceiling], "certificate"))
        short = sorted((closer[p][k], p, k) for _, p, k in rows if closer[p][k] < limit_m)
        if short and short[0][0] >= limit_m - exact_gives_back_m(scenario.robot):
            for some in (short[:NARROWEST], short[NARROWEST:]):
                if look([(p, k) for _, p, k in some], "exact") < limit_m:
                    break
    changed = zip(pieces, closer, finer, strict=True)
    return [replace(piece, clearance_m=values, finer=shapes) for piece, values, shapes in changed]


def _runs(places: Sequence[tuple[int, int]]) -> list[Run]:
    """Pieces and samples as runs of samples one after the other, none longer than LONGEST."""
    results = list[Run]()
    for (piece, _), of_run in groupby(enumerate(sorted(places)), lambda row: (row[1][0], row[1][1] - row[0])):
        samples = [k for _, (_, k) in of_run]
        results += [(piece, samples[i : i + LONGEST]) for i in range(0, len(samples), LONGEST)]
    return results


def _solved_anew(
    scenario: Scenario, distance: AnatomyDistance, piece: Piece, samples: Sequence[int], accuracy: Accuracy
) -> Closely:
    """Clearance of each sample's solved shapes, all allowances taken off, and these; -inf on another branch."""
    joints, variants = piece.joints[samples], piece.variants
    walks = [_these(scenario.robot, piece.theta_b[samples], piece.l_b[samples], accuracy)]
    if piece.walks.corners:
        points = [variants.at(s) for s in corner_states(len(variants.large))]
        walks += [_these(variants.robot(point), *variants.collars(point, joints), accuracy) for point in points]
    places = [_rows_by_sample(walk) for walk in walks]
    offset, nothing = piece.offset_m(scenario, accuracy), (-np.inf, None)
    solved: Closely = [nothing] * len(samples)
    for at, sample in enumerate(samples):
        if not all(at in rows for rows in places):
            continue
        rows = [(walk, of_walk[at]) for walk, of_walk in zip(walks, places, strict=True)]
        if max(_apart_m(scenario, piece, rows, sample)) > SAME_SHAPE_M:
            continue
        shapes = composed(scenario, rows, piece, sample)
        bodies = shapes.bodies_m
        owner = np.zeros(bodies.shape[0] * bodies.shape[1], dtype=np.intp)
        least = distance.least(bodies.reshape(-1, 3), np.tile(shapes.radius_m, len(bodies)), owner, 1)[0]
        solved[at] = float(least) - float(offset[sample]), shapes
    return solved


def strained_as_solved(scenario: Scenario, pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces with all strain larger by the share that the mesh misses of the largest, which exact geometry tells.

    Twist that decays within an element of the search mesh takes some per cent. Nothing changes where the equilibrium
    that was walked to is not solved again.
    """
    piece = max(pieces, key=lambda walked: float(walked.max_strain.max()))
    k = int(np.argmax(piece.max_strain))
    walk = _these(scenario.robot, piece.theta_b[[k]], piece.l_b[[k]], "exact")
    solved = _rows_by_sample(walk)
    if 0 not in solved or next(_apart_m(scenario, piece, [(walk, solved[0])], k)) > SAME_SHAPE_M:
        return list(pieces)
    least = float(piece.samples.max_strain[k])
    more = max(1.0, float(walk.max_strain[solved[0]]) / least) if least > 0 else 1.0

    def scaled(walked: Piece) -> Piece:
        samples = replace(walked.samples, max_strain=walked.samples.max_strain * more)
        return replace(walked, samples=samples, max_strain=walked.max_strain * more)

    return list(map(scaled, pieces))


def _these(robot: Robot, theta_b: Array, l_b: Array, accuracy: Accuracy) -> PathSamples:
    return robot.mechanics.check_path(theta_b, l_b, density=ONLY_THESE, accuracy=accuracy, bodies=True)


def _rows_by_sample(walk: PathSamples) -> dict[int, int]:
    """Rows of a walk by the number of the configuration that was given; those that failed are left out."""
    place = walk.segment + walk.fraction
    rows = np.flatnonzero((place == np.round(place)) & (walk.status != Status.FAILED))
    return {int(place[row]): int(row) for row in rows}


def _apart_m(scenario: Scenario, piece: Piece, rows: Sequence[tuple[PathSamples, int]], sample: int) -> Iterator[float]:
    """How far tips of shapes lie from those that were walked to, beyond what meshes differ by; of every walk."""
    for (walk, row), walked_to in zip(rows, (piece.samples, *piece.walks.corners), strict=True):
        bodies = shapes_of(scenario, walk.bodies[row])[0]
        before = shapes_of(scenario, walked_to.bodies[sample])[0]
        apart = np.linalg.norm(bodies[:, -1] - before[:, -1], axis=1)
        yield float(np.nan_to_num(apart.max(), nan=np.inf)) - mesh_allowance_m(scenario.robot, piece.accuracy)


NEAR_M = 1e-3  # of what is left: points that may come to be the narrowest
APART = 10  # samples between those that are looked at, which is 5 mm of motion at most


def at_worst_ends(scenario: Scenario, pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces less what small axes of the box do beyond first order, solved where the least clearance is left.

    All small axes are put to their ends at once, so that the narrowest point comes nearest to the anatomy, and so that
    it is displaced farthest. What the worst of these bodies differs by is taken off everywhere.
    """
    distance, variants = AnatomyDistance.of(scenario), pieces[0].variants
    if distance is None or not variants.small:
        return list(pieces)
    with ThreadPoolExecutor(cores()) as pool:
        beyond = list(
            pool.map(lambda row: _beyond_first_order(distance, pieces[row[0]], row[1]), narrow_places(pieces))
        )
    most = max(beyond, default=0.0)
    if not np.isfinite(most):
        return [replace(piece, walks=replace(piece.walks, fault=NO_EQUILIBRIUM)) for piece in pieces]
    return [replace(piece, clearance_m=piece.clearance_m - most, taken_m=piece.taken_m + most) for piece in pieces]


def narrow_places(pieces: Sequence[Piece], below_m: float = np.inf, most: int = NARROWEST) -> list[tuple[int, int]]:
    """Pieces and samples with less clearance, the narrowest first, those of a piece at least APART samples apart."""
    rows = sorted((float(c), p, k) for p, piece in enumerate(pieces) for k, c in enumerate(piece.clearance_m))
    chosen: list[tuple[int, int]] = []
    for clearance, p, k in rows:
        if clearance >= below_m or len(chosen) == most:
            break
        if all(p != other or abs(k - sample) >= APART for other, sample in chosen):
            chosen.append((p, k))
    return chosen


def _beyond_first_order(distance: AnatomyDistance, piece: Piece, sample: int) -> float:
    """[m] at a sample, of points near the anatomy, in the state that has least clearance; inf where a body is lost."""
    variants, phi = piece.variants, piece.phi[sample, : piece.pairs]
    middle = np.array(variants.at(piece.phi[sample, piece.pairs :].tolist()))
    here = _body(piece, sample, middle, phi)
    if here is None:
        return np.inf
    body, radius = here
    moved = []
    for axis in variants.small:
        end = _body(piece, sample, middle + np.array(variants.end(axis)), phi)
        if end is None:
            return np.inf
        moved.append(alike(end[0][None], body)[0] - body)
    by = np.array(moved)  # (A, N, 3)
    room = distance(body, np.full(len(body), np.inf)) - radius - lengths(by).sum(axis=0)
    near = np.flatnonzero(room <= room.min() + NEAR_M)
    k = int(np.argmin(room))
    shifts = GRADIENT_STEP_M * np.vstack([np.eye(3), -np.eye(3)])
    ends = distance(body[k] + shifts, np.full(6, np.inf)).reshape(2, 3)
    farthest = by[np.argmax(lengths(by[:, k])), k]
    beyond = [0.0]
    for direction in (ends[1] - ends[0], farthest):
        signs = np.where(by[:, k] @ direction < 0, -1.0, 1.0)
        point = middle.copy()
        point[list(variants.small)] = signs
        solved = _body(piece, sample, point, phi)
        if solved is None:
            return np.inf
        apart = lengths(alike(solved[0][None], body)[0] - body - np.tensordot(signs, by, axes=1))
        beyond.append(float(apart[near].max()))
    return max(beyond)


def _body(piece: Piece, sample: int, point: Array, phi: Array) -> tuple[Array, Array] | None:
    """Points (N, 3) and radii (N,) of the robot of a point of the box; None without an equilibrium."""
    try:
        at = piece.variants.configuration(tuple(point.tolist()), piece.joints[sample], piece.accuracy)
        bodies = at.bodies(phi[None], spacing_m=POINT_SPACING_M)
    except CtrplanError:
        return None
    return (bodies.point_m[0], bodies.radius_m) if bodies.solved[0] else None
