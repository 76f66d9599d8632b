"""The narrowest samples of walked pieces solved on the certificate mesh.

Pieces are walked on the mesh of the search, whose allowance may take too much from a clearance. Samples one after the
other are walked to as pieces are, the first of them from scratch.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.friction_states import POINT_SPACING_M, SAME_BRANCH_M, CornerShapes, mesh_allowance_m
from ctrplan.certificate.walked_piece import Piece, shapes_of
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity
from ctrplan.motion.checker import path_limits

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

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
            for (p, samples), found in zip(runs, solved, strict=True):
                for k, (clearance, shapes) in zip(samples, found, strict=True):
                    closer[p][k] = max(closer[p][k], clearance)
                    ceiling = min(ceiling, closer[p][k])
                    if shapes:
                        finer[p][k] = shapes
    changed = zip(pieces, closer, finer, strict=True)
    return [replace(piece, clearance_m=values, finer=shapes) for piece, values, shapes in changed]


def _runs(places: Sequence[tuple[int, int]]) -> list[Run]:
    """Pieces and samples as runs of samples one after the other, none longer than LONGEST."""
    found = list[Run]()
    for (piece, _), of_run in groupby(enumerate(sorted(places)), lambda row: (row[1][0], row[1][1] - row[0])):
        samples = [k for _, (_, k) in of_run]
        found += [(piece, samples[i : i + LONGEST]) for i in range(0, len(samples), LONGEST)]
    return found


def _on_certificate_mesh(
    scenario: Scenario, distance: AnatomyDistance, piece: Piece, samples: Sequence[int]
) -> list[tuple[float, CornerShapes | None]]:
    """Clearance of each sample's solved shapes, all allowances taken off, and these; -inf on another branch."""
    found = scenario.robot.mechanics.check_path(
        piece.theta_b[samples], piece.l_b[samples], density=ONLY_THESE, accuracy="certificate", bodies=True
    )
    offset, nothing = piece.offset_m(scenario, "certificate"), (-np.inf, None)
    solved: list[tuple[float, CornerShapes | None]] = [nothing] * len(samples)
    is_asked = (found.fraction == 1) | (np.arange(len(found.fraction)) == 0)
    for row in np.flatnonzero(is_asked & (found.status != Status.FAILED)):
        at = int(found.segment[row] + found.fraction[row])
        bodies, radius = shapes_of(scenario, found.bodies[row])
        if _apart_m(scenario, piece, samples[at], bodies) > SAME_BRANCH_M:
            continue
        shapes = CornerShapes(bodies, found.shape_stability[row], found.shape_max_strain[row], radius)
        owner = np.zeros(bodies.shape[0] * bodies.shape[1], dtype=np.intp)
        least = distance.least(bodies.reshape(-1, 3), np.tile(radius, len(bodies)), owner, 1)[0]
        solved[at] = float(least) - float(offset[samples[at]]), shapes
    return solved


def _apart_m(scenario: Scenario, piece: Piece, sample: int, bodies: Array) -> float:
    """How far tips of shapes (1 + C, N, 3) lie from those that were walked to, beyond what meshes differ by."""
    walked = shapes_of(scenario, piece.samples.bodies[sample])[0]
    apart = np.linalg.norm(bodies[:, -1] - walked[:, -1], axis=1)
    return float(np.nan_to_num(apart.max(), nan=np.inf)) - mesh_allowance_m(scenario.robot, piece.accuracy)
