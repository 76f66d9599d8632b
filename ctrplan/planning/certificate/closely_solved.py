"""The narrowest samples of walked pieces solved on the certificate mesh.

Pieces are walked on the mesh of the search, whose allowance may take too much from a clearance.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.cores import cores
from ctrplan.planning.certificate.allowances import SAME_BRANCH_M
from ctrplan.planning.certificate.anatomy_distance import AnatomyDistance
from ctrplan.planning.certificate.sample_states import SampleStates
from ctrplan.planning.certificate.walked_piece import FinerShapes, Piece
from ctrplan.planning.motion import path_limits

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

CHUNK = 4  # samples at a time


def closely_solved(scenario: Scenario, pieces: Sequence[Piece], spare_m: float) -> list[Piece]:
    """The narrowest samples solved on the certificate mesh: all for which the search mesh shows less than is left.

    So the least clearance does not depend on the mesh that a sample happened to be walked on, unless it is more than
    `spare_m` beyond the limit.
    """
    distance, limits = AnatomyDistance.of(scenario), path_limits(scenario)
    if distance is None:
        return list(pieces)
    closer = [piece.clearance_m.copy() for piece in pieces]
    finer: list[dict[int, FinerShapes]] = [{} for _ in pieces]
    rows = sorted((float(c), p, k) for p, piece in enumerate(pieces) for k, c in enumerate(piece.clearance_m))
    narrow = [row for row in rows if pieces[row[1]].accuracy == "search"]
    ceiling = limits.clearance_m + spare_m  # of the least clearance that is asked for
    with ThreadPoolExecutor(cores()) as pool:
        for begin in range(0, len(narrow), CHUNK):
            if narrow[begin][0] >= ceiling or ceiling < limits.clearance_m:
                break
            chunk = narrow[begin : begin + CHUNK]
            solved = pool.map(lambda row: _on_certificate_mesh(scenario, distance, pieces[row[1]], row[2]), chunk)
            for (value, p, k), (found, shapes) in zip(chunk, solved, strict=True):
                closer[p][k] = max(value, found)
                ceiling = min(ceiling, closer[p][k])
                if shapes:
                    finer[p][k] = shapes
    changed = zip(pieces, closer, finer, strict=True)
    return [replace(piece, clearance_m=values, finer=shapes) for piece, values, shapes in changed]


def _on_certificate_mesh(
    scenario: Scenario, distance: AnatomyDistance, piece: Piece, sample: int
) -> tuple[float, FinerShapes | None]:
    """Clearance of the solved shapes of a sample, all allowances taken off, and the shapes; -inf on another branch."""
    states = SampleStates(scenario, piece, sample, "certificate")
    solved, radius = states.known
    if states.apart_m > SAME_BRANCH_M:
        return -np.inf, None
    points = np.concatenate([one.body_m for one in solved.values()])
    owner = np.zeros(len(points), dtype=np.intp)
    least = float(distance.least(points, np.tile(radius, len(solved)), owner, 1)[0])
    return least - float(piece.offset_m(scenario, "certificate")[sample]), (solved, radius)
