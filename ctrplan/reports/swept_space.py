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
    from ctrplan.reports.pose import Pose

NODES = 400_000
FINEST_M = 1.0e-3
THINNEST_CELLS = 0.9  # a thinner rod could slip between the nodes of the grid
NEIGHBOURS = 12  # spheres looked at by each node: those around it, whatever their radii


def swept_surface(poses: Sequence[Pose]) -> Surface:
    """The union of all poses' envelopes, each a row of spheres along its centreline."""
    centres = np.concatenate([pose.envelope.centreline_m for pose in poses])
    radii = np.concatenate([pose.envelope.radius_m for pose in poses])
    rim = float(radii.max()) + FINEST_M
    lower, upper = centres.min(axis=0) - rim, centres.max(axis=0) + rim
    cell = max(FINEST_M, float(np.cbrt((upper - lower).prod() / NODES)))
    nodes, counts = _grid(lower - cell, upper + cell, cell)
    radii = np.maximum(radii, THINNEST_CELLS * cell)
    far = float(radii.max()) + 2 * cell
    apart, which = cKDTree(centres).query(nodes, k=min(NEIGHBOURS, len(centres)), distance_upper_bound=far)
    apart, which = apart.reshape(len(nodes), -1), which.reshape(len(nodes), -1)
    values = np.minimum(apart - np.append(radii, 0.0)[which], far).min(axis=1)  # no neighbour: infinitely far, number K
    vertices, faces, *_ = igl.marching_cubes(values, nodes, *counts, 0.0)
    return Surface(
        np.asarray(vertices, dtype=np.float64).reshape(-1, 3), np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    )


def _grid(lower: Array, upper: Array, cell: float) -> tuple[Array, tuple[int, int, int]]:
    """Nodes (K, 3), x running fastest, and their numbers along each axis."""
    axes = [np.arange(a, b + cell, cell) for a, b in zip(lower, upper, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), (len(axes[0]), len(axes[1]), len(axes[2]))
