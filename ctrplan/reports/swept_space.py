"""The space that the envelope sweeps along a path, as one surface to look at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import igl
import numpy as np
from scipy.spatial import cKDTree

from ctrplan.base.arrays import Array
from ctrplan.reports.surface import Surface

if TYPE_CHECKING:
    from ctrplan.base.surface import Rod
    from ctrplan.reports.pose import Pose

NODES = 400_000
FINEST_M = 1.0e-3
THINNEST_CELLS = 0.9  # a thinner rod could slip between the nodes of the grid
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
    largest = float(radii.max())
    lifted = np.column_stack([centres, np.sqrt(largest**2 - radii**2)])
    _, which = cKDTree(lifted).query(np.pad(nodes, ((0, 0), (0, 1))), distance_upper_bound=largest + 2 * cell)
    values = np.full(len(nodes), 2 * cell)
    near = which < len(centres)
    values[near] = np.linalg.norm(nodes[near] - centres[which[near]], axis=1) - radii[which[near]]
    vertices, faces, *_ = igl.marching_cubes(values, nodes, *counts, 0.0)
    return Surface(
        np.asarray(vertices, dtype=np.float64).reshape(-1, 3), np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    )


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
