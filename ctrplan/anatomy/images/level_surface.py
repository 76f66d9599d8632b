"""The surface between voxels: labels smoothed without moving what is curved, then marching cubes, slab by slab.

A label map says of each voxel's centre whether it is inside. Its occupancy is smoothed by the kernel G - s^2 lap(G), G
being a normal distribution of s = SIGMA voxels. Within any plane through its middle it has no second moment, so that
the level 1/2 stays where a curved surface is (a normal distribution alone draws a tube of radius R in by s^2 / (2 R)).
Every voxel's centre stays on its side. Grey values need no smoothing: the surface is where they cross the threshold.
"""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ctrplan.anatomy.images.structure import Mask, Structure
from ctrplan.base.arrays import Array

SIGMA = 1.5  # voxels
TRUNCATED = 3.0  # standard deviations
HALO = 7  # planes that smoothing looks at on either side
LEAST = 0.02  # by which a voxel stays on its side of 1/2
TINY = 1e-6  # of the largest value: what grey values differ from the threshold by at least
SLAB = 24  # planes looked at together
LABEL_ERROR, THIN_ERROR, GREY_ERROR = (
    0.6,
    0.9,
    0.15,
)  # of the widest voxel, see benchmarks/run.py scans: what a surface is off by at most
CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)  # (x, y, z)

Grid = NDArray[np.float32]
Indices = NDArray[np.int64]


def level_surface(chosen: Structure) -> tuple[Array, Indices]:
    """Vertices (V, 3) along (x, y, z) in voxels of the structure's grid; triangles (F, 3), closed and outward."""
    shape = chosen.inside.shape
    keys, places, corners, count = [], [], [], 0
    for first in range(0, shape[0] - 1, SLAB):
        planes = slice(first, min(first + SLAB + 1, shape[0]))
        vertices, faces = _marched(_heights(chosen, planes))
        vertices[:, 2] += first
        keys.append(_edge_keys(vertices, shape))
        places.append(vertices)
        corners.append(faces + count)
        count += len(vertices)
    _, rows, index = np.unique(np.concatenate(keys), return_index=True, return_inverse=True)
    faces = index.reshape(-1)[np.concatenate(corners)]
    return np.concatenate(places)[rows], np.ascontiguousarray(faces, dtype=np.int64)


def _heights(chosen: Structure, planes: slice) -> Grid:
    """How far inside the voxels of some planes are, positive inside; only the sign and ratios have a meaning."""
    inside = chosen.inside[planes]
    if chosen.above is not None:
        values = chosen.above[planes]
        return _on_its_side(values, inside, TINY * max(float(np.abs(values).max()), 1e-30))
    start = max(planes.start - HALO, 0)
    around = chosen.inside[start : planes.stop + HALO]
    smooth = gaussian_filter(around.astype(np.float32), SIGMA, truncate=TRUNCATED, mode="constant")
    sharp = (smooth - SIGMA**2 * _laplacian(smooth))[planes.start - start :][: len(inside)] - np.float32(0.5)
    return _on_its_side(sharp, inside, LEAST)


def _on_its_side(values: Grid, inside: Mask, least: float) -> Grid:
    """The values, at least so far above zero inside and below it outside."""
    return np.asarray(np.where(inside, np.maximum(values, least), np.minimum(values, -least)), dtype=np.float32)


def _laplacian(values: Grid) -> Grid:
    """Sum of the second differences; zeros beyond the ends."""
    total = -6 * values
    for axis in range(3):
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        total[tuple(behind)] += values[tuple(ahead)]
        total[tuple(ahead)] += values[tuple(behind)]
    return total


def _marched(heights: Grid) -> tuple[Array, Indices]:
    """Surface of a slab (nz, ny, nx); only cells that it goes through are handed to marching cubes."""
    inside = (heights > 0).view(np.int8)
    sums = inside[:-1] + inside[1:]
    sums = sums[:, :-1] + sums[:, 1:]
    sums = sums[:, :, :-1] + sums[:, :, 1:]
    cell = np.argwhere((sums > 0) & (sums < 8))[:, ::-1]
    if not len(cell):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    _, ny, nx = heights.shape
    strides = np.array([1, nx, nx * ny])
    nodes = (cell @ strides)[:, None] + CORNERS @ strides
    number = np.zeros(heights.size, np.int64)
    number[nodes.reshape(-1)] = 1
    used = np.flatnonzero(number)
    number[used] = np.arange(len(used))
    where = np.stack([used % nx, used // nx % ny, used // (nx * ny)], axis=1).astype(np.float64)
    values = heights.reshape(-1)[used].astype(np.float64)
    vertices, faces, _ = igl.marching_cubes(values, where, number[nodes], 0.0)
    return np.array(vertices), np.asarray(faces)[:, ::-1]


def _edge_keys(vertices: Array, shape: tuple[int, ...]) -> Indices:
    """One number for the lattice edge that each vertex lies on, so that slabs can be sewn together."""
    base = np.floor(vertices)
    share = np.minimum(vertices - base, base + 1 - vertices)
    nz, ny, nx = shape
    node = base.astype(np.int64) @ np.array([1, nx, nx * ny])
    key: Indices = node * 3 + share.argmax(axis=1)
    return key
