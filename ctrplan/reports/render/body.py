"""Bodies as the renderer takes them: triangles with a colour, and how much of it covers what is behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface


@dataclass(frozen=True, eq=False)
class Body:
    """A surface to draw. Glass covers little where it is looked at squarely, and more at its rim."""

    surface: Surface
    colour: Array  # (3,) in [0, 1], or (V, 3) of each vertex
    opacity: float = 1.0  # seen squarely
    rim: float = 1.0  # seen along it


def vertex_normals(surface: Surface) -> Array:
    """(V, 3) unit vectors, means of the triangles around each vertex by their areas; zero where there are none."""
    a, b, c = np.moveaxis(surface.vertices_m[surface.faces], 1, 0)
    across = np.cross(b - a, c - a)
    corners = surface.faces.T.ravel()
    count = len(surface.vertices_m)
    normal = np.stack([np.bincount(corners, np.tile(row, 3), minlength=count) for row in across.T], axis=1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit: Array = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    return unit
