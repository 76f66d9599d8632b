"""Triangle surfaces to look at, thinned to what a screen can show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.anatomy.mesh_thinning import collapsed
from ctrplan.base.surface import Surface

if TYPE_CHECKING:
    from ctrplan.anatomy.parts import AnatomyPart


def anatomy_surface(part: AnatomyPart, triangles: int = 12_000) -> Surface:
    """The surface of a part in no more than `triangles`; coarser ones as they are."""
    return thinned(part.shape.surface(), triangles)


def thinned(surface: Surface, triangles: int) -> Surface:
    """The surface in no more than `triangles`: to look at, not to measure.

    Edges collapse where the package for that is there, which keeps thin vessels whole; then vertices merge in cells of
    a grid.
    """
    if len(surface.faces) > triangles and (fewer := collapsed(surface.vertices_m, surface.faces, triangles)):
        surface = Surface(*fewer)
    cell = float(np.sqrt(2 * _area(surface) / triangles))
    while len(surface.faces) > triangles:
        surface = _merged(surface, cell)
        cell *= 1.2
    return surface


def _area(surface: Surface) -> float:
    a, b, c = np.moveaxis(surface.vertices_m[surface.faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _merged(surface: Surface, cell_m: float) -> Surface:
    """Every vertex at the mean of its cell, triangles that collapse left out."""
    cells = np.floor(surface.vertices_m / cell_m).astype(np.int64)
    _, label, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    label = label.reshape(-1)  # numpy 2.0 returns it as a column
    mean = np.stack([np.bincount(label, column) / count for column in surface.vertices_m.T], axis=1)
    faces = label[surface.faces]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Surface(mean, faces[distinct])
