"""Triangle surfaces: of circles swept along a centreline, of capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, Z
from ctrplan.base.package import shown


@shown
@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles, turned outward where they enclose a body."""

    vertices_m: Array  # (V, 3)
    faces: NDArray[np.int64]  # (F, 3)


@dataclass(frozen=True, eq=False)
class Rod:
    """A circular body around a centreline of N stations."""

    centreline_m: Array  # (N, 3)
    tangent: Array  # (N, 3) unit vectors
    radius_m: Array  # (N,)

    def surface(self, sides: int) -> Surface:
        """Watertight: a ring of `sides` vertices, at the radius, per station, and a vertex in the middle of each end.

        Vertices are ordered alike for any rod of as many stations, (N * sides + 2, 3), and so are the faces. Rings
        stand in frames carried along without twist from the x axis, so that rods that move smoothly do not flicker.
        """
        return Surface(rod_vertices([self], sides)[0], rod_faces(len(self.radius_m), sides))


def rod_vertices(rods: Sequence[Rod], sides: int) -> Array:
    """(R, N * sides + 2, 3) vertices of the surfaces of rods with N stations each, all at once."""
    line, tangent = np.stack([rod.centreline_m for rod in rods]), np.stack([rod.tangent for rod in rods])
    normal, binormal = _frames(tangent)
    angle = 2 * np.pi * np.arange(sides)[:, None] / sides
    spokes = np.cos(angle) * normal[:, :, None] + np.sin(angle) * binormal[:, :, None]
    rings = line[:, :, None] + np.stack([rod.radius_m for rod in rods])[:, :, None, None] * spokes
    return np.concatenate([rings.reshape(len(rods), -1, 3), line[:, [0, -1]]], axis=1)


def _frames(tangent: Array) -> tuple[Array, Array]:
    """Normals and binormals (R, N, 3), (R, N, 3) of R rods that are twisted as little as the tangents allow."""
    normal = np.empty_like(tangent)
    carried = np.eye(3)[np.abs(tangent[:, 0]).argmin(axis=1)]
    for k in range(tangent.shape[1]):
        ahead = tangent[:, k]
        carried = carried - (carried * ahead).sum(axis=1, keepdims=True) * ahead
        carried /= np.sqrt((carried * carried).sum(axis=1, keepdims=True))
        normal[:, k] = carried
    return normal, np.cross(tangent, normal)


@cache
def rod_faces(stations: int, sides: int) -> NDArray[np.int64]:
    """Triangles between the vertices of a rod, the same for all rods of as many stations."""
    ring, side = np.meshgrid(np.arange(stations - 1), np.arange(sides), indexing="ij")
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    wall = np.stack([a, b, b + sides, a, b + sides, a + sides], axis=-1).reshape(-1, 3)
    around, last = np.arange(sides), (stations - 1) * sides
    start, end = np.full(sides, stations * sides), np.full(sides, stations * sides + 1)
    first_cap = np.stack([start, (around + 1) % sides, around], axis=1)
    last_cap = np.stack([end, last + around, last + (around + 1) % sides], axis=1)
    faces = np.asarray(np.concatenate([wall, first_cap, last_cap]), dtype=np.int64)
    faces.setflags(write=False)  # shared by all rods of as many stations
    return faces


def capsule(start_m: Array, end_m: Array, radius_m: float, sides: int = 32) -> Surface:
    """All points within radius_m of the line from start_m to end_m (3,); a sphere where the two are one."""
    axis = end_m - start_m
    length = float(np.linalg.norm(axis))
    direction = axis / length if length > 0 else Z
    latitude = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
    along = radius_m * np.sin(latitude)
    middle = start_m + np.where(latitude > 0, length, 0.0)[:, None] * direction
    if length > 0:  # the equator of both ends
        equator = len(latitude) // 2
        middle, along = np.insert(middle, equator + 1, end_m, axis=0), np.insert(along, equator + 1, 0.0)
    radius = np.sqrt(np.maximum(radius_m**2 - along**2, 0.0))
    return Rod(middle + along[:, None] * direction, np.tile(direction, (len(along), 1)), radius).surface(sides)
