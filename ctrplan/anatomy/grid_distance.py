"""Distance to one part at every node of a grid: exact near the surface, interpolated from coarser levels far from it.

Exact queries cost microseconds, and most nodes of a grid lie far from the surface. Distances are therefore exact on a
grid COARSEST times coarser; each halving of the step interpolates and then replaces by exact values all nodes within
FAR coarse steps S. What stays interpolated is at least (FAR - sqrt(3) / 2) S from the surface, since distance is
1-Lipschitz and each node within sqrt(3) / 2 S of what it is interpolated from. On either side of the surface distance
is a minimum of cones |x - p| with second derivatives of at most 1 / |x - p|, so that interpolation exceeds the unsigned
distance by at most 3 S^2 / (8 d): below 2 % of d. It can fall short by sqrt(3) / 2 S, on the medial axis.
"""

import numpy as np

from ctrplan.anatomy.distance_field import Grid
from ctrplan.anatomy.parts import CHUNK_POINTS, AnatomyPart, surface_distance
from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress

COARSEST = 4  # grid steps of the coarsest level, a power of two; node counts are a multiple of it plus one
FAR = 6.0


def grid_distance(
    part: AnatomyPart, origin_m: Array, spacing_m: float, shape: tuple[int, int, int], report: Progress
) -> Grid:
    """Distance (nx, ny, nz) to the part's surface at the nodes origin_m + spacing_m (i, j, k) [m], negative within it.

    report: called with the fraction done.
    """
    step = COARSEST
    values = np.empty(tuple((n - 1) // step + 1 for n in shape), dtype=np.float32)
    _fill(values, np.inf, part, origin_m, spacing_m * step, None)
    while step > 1:
        limit, step = FAR * spacing_m * step, step // 2
        values = _halved(values)
        _fill(values, limit, part, origin_m, spacing_m * step, report if step == 1 else None)
    return values


def _fill(values: Grid, limit: float, part: AnatomyPart, origin: Array, step: float, report: Progress | None) -> None:
    """Replace by exact distances: all values, or with a finite `limit` [m] those within it that are interpolated."""
    planes = max(1, CHUNK_POINTS // values[0].size)
    for first in range(0, len(values), planes):
        block = values[first : first + planes]
        if np.isfinite(limit):
            wanted = np.abs(block) <= limit
            wanted[first % 2 :: 2, ::2, ::2] = False  # nodes of the coarse level are exact already
            node = np.argwhere(wanted)
        else:
            node = np.indices(block.shape).reshape(3, -1).T
        if len(node):
            points = origin + step * (node + (first, 0, 0))
            block[tuple(node.T)] = surface_distance(part, np.ascontiguousarray(points))
        if report:
            report(min(1.0, (first + planes) / len(values)))


def _halved(coarse: Grid) -> Grid:
    """Trilinear interpolation to half the grid step: (n, ...) nodes become (2 n - 1, ...)."""
    fine = np.empty(tuple(2 * n - 1 for n in coarse.shape), dtype=np.float32)
    fine[::2, ::2, ::2] = coarse
    fine[1::2, ::2, ::2] = (coarse[:-1] + coarse[1:]) / 2
    fine[:, 1::2, ::2] = (fine[:, :-1:2, ::2] + fine[:, 2::2, ::2]) / 2
    fine[:, :, 1::2] = (fine[:, :, :-1:2] + fine[:, :, 2::2]) / 2
    return fine
