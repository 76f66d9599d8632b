"""Surfaces of bodies made of rounded pieces that flow into each other: signed distances, marching cubes; mm."""

from collections.abc import Callable, Sequence

import igl
import numpy as np
from numpy.typing import ArrayLike

from anatomies.swept import Array, Mesh

Distance = Callable[[Array], Array]  # (K, 3) points -> (K,) distances, negative inside
LEAST_SHARE = 0.08  # of a cell: no node lies nearer to the surface, so that no triangle is a sliver


def round_cone(start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float | None = None) -> Distance:
    """A straight tube with rounded ends whose radius changes along the way."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    last = start_radius if end_radius is None else end_radius

    def distance(points: Array) -> Array:
        axis = b - a
        along = np.clip((points - a) @ axis / (axis @ axis), 0.0, 1.0)
        radius = start_radius + along * (last - start_radius)
        return np.asarray(np.linalg.norm(points - a - along[:, None] * axis, axis=1) - radius)

    return distance


def box(lower: ArrayLike, upper: ArrayLike, rounding: float = 0.0) -> Distance:
    """A block with rounded edges."""
    low, high = np.asarray(lower, dtype=np.float64) + rounding, np.asarray(upper, dtype=np.float64) - rounding

    def distance(points: Array) -> Array:
        off = np.abs(points - (low + high) / 2) - (high - low) / 2
        outside = np.linalg.norm(np.maximum(off, 0.0), axis=1)
        return np.asarray(outside + np.minimum(off.max(axis=1), 0.0) - rounding)

    return distance


def united(parts: Sequence[Distance], fillet: float) -> Distance:
    """The union, its concave edges rounded over about `fillet` mm (polynomial smooth minimum)."""

    def distance(points: Array) -> Array:
        result = parts[0](points)
        for part in parts[1:]:
            other = part(points)
            near = np.maximum(fillet - np.abs(result - other), 0.0) / fillet
            result = np.minimum(result, other) - near * near * fillet / 4
        return np.asarray(result)

    return distance


def without(body: Distance, hole: Distance) -> Distance:
    """The body less the hole."""
    return lambda points: np.maximum(body(points), -hole(points))


def cut_at_z(body: Distance, z: float) -> Distance:
    """What of the body lies at or above z, closed by a plane."""
    return lambda points: np.maximum(body(points), z - points[:, 2])


def surface(body: Distance, lower: ArrayLike, upper: ArrayLike, cell: float) -> Mesh:
    """Closed triangles of the surface within a box that holds it, in cubes of `cell` mm."""
    low = np.asarray(lower, dtype=np.float64)
    counts = np.ceil((np.asarray(upper, dtype=np.float64) - low) / cell).astype(int) + 1
    axes = [low[k] + cell * np.arange(counts[k]) for k in range(3)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")  # x runs fastest
    nodes = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    values = np.round(body(nodes), 9)
    values = np.where(np.abs(values) < LEAST_SHARE * cell, np.where(values < 0, -1, 1) * LEAST_SHARE * cell, values)
    vertices, faces, *_ = igl.marching_cubes(values, nodes, *(int(n) for n in counts), 0.0)
    a, b, c = np.moveaxis(np.asarray(vertices)[faces], 1, 0)
    turned = np.einsum("ki,ki->", a, np.cross(b, c)) < 0  # enclosed volume
    return np.asarray(vertices), np.asarray(faces[:, ::-1] if turned else faces, dtype=np.int64)
