"""A structure's surface from a mesh file: in the scenario's frame, closed if it is a body, thinned if it is huge."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ctrplan.anatomy.mesh_file import Unit, Up, axes_notes, is_gltf, read_triangles, stated_frame, stated_unit
from ctrplan.anatomy.mesh_repair import (
    Indices,
    MeshDefect,
    MeshDefectError,
    MeshRefusal,
    Repair,
    closed,
    merged,
    odd_edges,
    refuse_open,
    turned_outward,
)
from ctrplan.anatomy.patient_frame import Frame, to_scenario
from ctrplan.anatomy.shape import PartEntry
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.surface import Surface
from ctrplan.storage.toml_document import TomlTable

HUGE, ENOUGH = 1_000_000, 200_000  # triangles: what is thinned, and to what
MOST_ERROR_M = 0.05e-3
TRIES = 3  # each with twice the triangles of the one before
HALVINGS = 4
CHUNK = 1 << 17


def thinned(vertices: Array, faces: Indices) -> tuple[Array, Indices, float]:
    """The surface in fewer triangles and by how much [m] it may be off, at most MOST_ERROR_M.

    As it is, and 0, where it is not HUGE, can't be thinned by as little, or the extra package is missing.
    """
    if len(faces) <= HUGE:
        return vertices, faces, 0.0
    for doubled in range(TRIES):
        if (wanted := 2**doubled * ENOUGH) >= len(faces) or (result := collapsed(vertices, faces, wanted)) is None:
            break
        points, triangles = result
        error = np.inf if len(odd_edges(triangles)) else _error_m(vertices, faces, points, triangles)
        if error <= MOST_ERROR_M:
            return points, triangles, float(error)
    return vertices, faces, 0.0


def thinning_note(faces: Indices, error_m: float) -> tuple[str, ...]:
    """What there is to know of it; nothing where nothing was done."""
    if not error_m:
        return ()
    return (f"was thinned to {len(faces)} triangles, off by {error_m * MM_PER_M:.2g} mm at most, part of the margin",)


def collapsed(vertices: Array, faces: Indices, triangles: int) -> tuple[Array, Indices] | None:
    """The surface (V, 3) [m], (F, 3) in about so many triangles, by edges whose collapse moves it least.

    None where the extra package is missing.
    """
    if (simplify := _simplify()) is None:
        return None
    share = max(0.0, 1 - triangles / len(faces))
    points, left = simplify(vertices * MM_PER_M, faces.astype(np.int32), share)[:2]
    return np.ascontiguousarray(points, dtype=np.float64) / MM_PER_M, np.ascontiguousarray(left, dtype=np.int64)


def _simplify() -> Any:
    try:
        return importlib.import_module("fast_simplification").simplify
    except ImportError:
        return None


def _error_m(vertices: Array, faces: Indices, thin: Array, triangles: Indices) -> float:
    """How far any point of a surface lies from its thinned one, bounded.

    So far is what keeps away from the thinned one less away from the surface. Nothing more is asked of the thinned one:
    a robot that comes to where it bulges crosses the surface before.
    """
    import igl  # slow to import

    tree = igl.AABB()
    tree.init(thin, triangles)
    error = 0.0
    for first in range(0, len(faces), CHUNK):
        error = max(error, _bound_m(vertices[faces[first : first + CHUNK]], tree, thin, triangles, HALVINGS))
        if error > MOST_ERROR_M:
            return error
    return error


def _bound_m(corners: Array, tree: Any, thin: Array, triangles: Indices, halvings: int) -> float:
    """Bound on the distance of any point of triangles (K, 3, 3) to the thinned surface.

    Distance to one triangle, the nearest to the middle, is convex: no point is farther from it than the corners are.
    Triangles that lie across an edge of the thinned surface are halved.
    """
    squared, nearest, _ = tree.squared_distance(thin, triangles, np.ascontiguousarray(corners.mean(axis=1)))
    if (surely := float(np.sqrt(np.max(squared)))) > MOST_ERROR_M:
        return surely  # too far in any case
    target = thin[triangles[np.asarray(nearest).ravel()]]
    away = _to_triangles_m(corners, target)
    wide = np.flatnonzero(away > MOST_ERROR_M)
    if not len(wide) or not halvings:
        return float(away.max())
    rest = float(np.delete(away, wide).max(initial=0.0))
    a, b, c = np.moveaxis(corners[wide], 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    four = [np.stack(triangle, axis=1) for triangle in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return max(rest, _bound_m(np.concatenate(four), tree, thin, triangles, halvings - 1))


def _to_triangles_m(corners: Array, target: Array) -> Array:
    """(K,) how far the corners of triangles (K, 3, 3) lie from other triangles (K, 3, 3), one each, at the most."""
    sides = np.roll(target, -1, axis=1) - target
    normal = np.cross(sides[:, 0], sides[:, 1])
    length = np.linalg.norm(normal, axis=1)
    normal /= np.where(length > 0, length, 1.0)[:, None]
    inward = np.cross(normal[:, None], sides)
    offset = np.einsum("ksx,ksx->ks", inward, target)
    beyond = np.einsum("kpx,ksx->kps", corners, inward) < offset[:, None]  # of which side a corner lies outside
    height = np.abs(np.einsum("kpx,kx->kp", corners - target[:, :1], normal))
    k, p = np.nonzero(beyond.any(axis=2) | (length == 0)[:, None])
    height[k, p] = _to_sides_m(corners[k, p], target[k], sides[k])
    return np.asarray(height.max(axis=1))


def _to_sides_m(points: Array, starts: Array, sides: Array) -> Array:
    """(K,) from points (K, 3) to the nearest of three segments each, with starts and sides (K, 3, 3)."""
    offset = points[:, None] - starts
    squared = np.maximum(np.einsum("ksx,ksx->ks", sides, sides), 1e-300)
    along = np.clip(np.einsum("ksx,ksx->ks", offset, sides) / squared, 0, 1)
    return np.asarray(np.linalg.norm(offset - along[..., None] * sides, axis=2).min(axis=1))


class OfMeshFile(PartEntry):
    """What is read of a mesh file, and how: None is what its format says."""

    file: str
    unit: Unit | None = None  # of glTF m, of other files to be said
    up: Up | None = None  # the axis that is turned up to z: y of glTF, else z
    frame: Frame | None = None
    group: str | None = None


class SurfaceFile(NamedTuple):
    """Vertices (V, 3) [m] in the scenario's frame and triangles (F, 3); notes of what was repaired.

    error_m: what thinning may have moved the surface by.
    """

    vertices_m: Array
    faces: Indices
    file: str
    notes: tuple[str, ...]
    error_m: float


def read_body(table: TomlTable, path: Path, choice: OfMeshFile, repair: Repair) -> SurfaceFile:
    """The closed surface of a body that `table` names, turned outward. Raises InputError."""
    _check_unit(table, path, choice)
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    try:
        vertices, faces = merged(*read_triangles(path, choice.unit, choice.group, choice.up))
        faces, notes = closed(vertices, faces, repair)
        refuse_open(vertices, faces)
        vertices, faces, error = thinned(vertices, faces)
        faces = turned_outward(vertices, faces)
        notes = (*axes_notes(path, choice.unit, choice.up), *notes, *thinning_note(faces, error))
        return SurfaceFile(_placed(table, path, choice.frame, vertices), faces, str(path), notes, error)
    except MeshRefusal as refusal:
        fault = table.fault(str(refusal), "file")
        if refusal.place_m is None:
            raise fault from refusal.__cause__
        raise MeshDefectError(fault, MeshDefect(path, Surface(vertices, faces), refusal.place_m)) from None


def read_sheet(table: TomlTable, path: Path, choice: OfMeshFile) -> SurfaceFile:
    """A surface of any kind that `table` names, open ones as well. Raises InputError."""
    _check_unit(table, path, choice)
    try:
        vertices, faces = merged(*read_triangles(path, choice.unit, choice.group, choice.up))
    except MeshRefusal as refusal:
        raise table.fault(str(refusal), "file") from refusal.__cause__
    notes = axes_notes(path, choice.unit, choice.up)
    return SurfaceFile(_placed(table, path, choice.frame, vertices), faces, str(path), notes, 0.0)


def _check_unit(table: TomlTable, path: Path, choice: OfMeshFile) -> None:
    """Raises InputError where neither the table nor the file or its format says a unit."""
    if choice.unit is None and not is_gltf(path) and stated_unit(path) is None:
        raise table.fault("is missing: the file does not say whether its numbers are in mm, cm, m or in", "unit")


def _placed(table: TomlTable, path: Path, frame: Frame | None, vertices: Array) -> Array:
    return np.ascontiguousarray(vertices * to_scenario(table, stated_frame(path), frame, is_patient=False))
