"""The space that the envelope sweeps along a path, as one surface to look at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import igl
import numpy as np
from scipy.spatial import cKDTree

from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface

if TYPE_CHECKING:
    from ctrplan.base.surface import Rod
    from ctrplan.reports.pose import Pose

NODES = 400_000
FINEST_M = 1.0e-3
THINNEST_CELLS = 0.9  # a thinner rod could slip between the nodes of the grid
STRIDE, FAR_CELLS = 4, 8
SPACING_CELLS = 0.5  # of the spheres that stand for a rod, or thin ones would be beads on a string


def swept_surface(poses: Sequence[Pose]) -> Surface:
    """The union of all poses' envelopes, each a row of spheres along its centreline.

    Which sphere a point is deepest in, or nearest to, is asked by its power |x - c|^2 - r^2: that is the nearest
    neighbour among the points (c, sqrt(R^2 - r^2)) in four dimensions, R being the largest radius.
    """
    rods = [pose.envelope for pose in poses]
    largest = max(float(rod.radius_m.max()) for rod in rods)
    centres = np.concatenate([rod.centreline_m for rod in rods])
    lower, upper = centres.min(axis=0) - largest - FINEST_M, centres.max(axis=0) + largest + FINEST_M
    cell = max(FINEST_M, float(np.cbrt((upper - lower).prod() / NODES)))
    nodes, counts = _grid(lower - cell, upper + cell, cell)
    centres, radii = _spheres(rods, cell)
    values = _depths(nodes, counts, centres, radii, cell)
    vertices, faces, *_ = igl.marching_cubes(values, nodes, *counts, 0.0)
    return Surface(
        np.asarray(vertices, dtype=np.float64).reshape(-1, 3), np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    )


def _depths(nodes: Array, counts: tuple[int, int, int], centres: Array, radii: Array, cell: float) -> Array:
    """(K,) distance [m] from the union of spheres, negative within; of nodes far from its surface the sign alone.

    Every fourth node along each axis is asked first. Where it is farther from the surface than from a node, that node
    is on the same side. Outside, the fourth dimension tells a distance that no sphere, however large, comes below.
    """
    largest, far = float(radii.max()), FAR_CELLS * cell
    tree = cKDTree(np.column_stack([centres, np.sqrt(largest**2 - radii**2)]))

    def depths(places: Array) -> tuple[Array, Array]:
        lifted, which = tree.query(np.pad(places, ((0, 0), (0, 1))), distance_upper_bound=largest + far)
        found, near = np.full(len(places), far), which < len(centres)
        found[near] = np.linalg.norm(places[near] - centres[which[near]], axis=1) - radii[which[near]]
        return found, np.where(found > 0, np.minimum(lifted - largest, far), found)

    places = np.unravel_index(np.arange(len(nodes)), counts, order="F")
    some = np.flatnonzero(np.all([place % STRIDE == 0 for place in places], axis=0))
    asked = np.empty(tuple((count - 1) // STRIDE + 1 for count in counts))
    asked[tuple(place[some] // STRIDE for place in places)] = depths(nodes[some])[1]
    beside = ((place + STRIDE // 2) // STRIDE for place in places)
    values: Array = asked[tuple(np.minimum(row, size - 1) for row, size in zip(beside, asked.shape, strict=True))]
    close = np.abs(values) < (np.sqrt(3) * (STRIDE - 1) + 1) * cell
    values[close] = depths(nodes[close])[0]
    return values


def _spheres(rods: Sequence[Rod], cell: float) -> tuple[Array, Array]:
    """Centres (K, 3) and radii (K,) along the rods, none thinner than the grid can hold."""
    found = []
    for rod in rods:
        s_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rod.centreline_m, axis=0), axis=1))])
        at = np.linspace(0.0, s_m[-1], int(s_m[-1] / (SPACING_CELLS * cell)) + 2)
        found.append(np.column_stack([np.interp(at, s_m, row) for row in (*rod.centreline_m.T, rod.radius_m)]))
    rows = np.concatenate(found)
    return rows[:, :3], np.maximum(rows[:, 3], THINNEST_CELLS * cell)


def _grid(lower: Array, upper: Array, cell: float) -> tuple[Array, tuple[int, int, int]]:
    """Nodes (K, 3), x running fastest, and their numbers along each axis."""
    axes = [np.arange(a, b + cell, cell) for a, b in zip(lower, upper, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), (len(axes[0]), len(axes[1]), len(axes[2]))
