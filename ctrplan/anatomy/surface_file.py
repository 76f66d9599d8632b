"""A structure's surface from a mesh file: in the scenario's frame, closed if it is a body, thinned if it is huge."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ctrplan.anatomy.mesh_defect import MeshDefect, MeshDefectError
from ctrplan.anatomy.mesh_file import read_triangles, stated_frame
from ctrplan.anatomy.mesh_holes import Repair, closed
from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal, merged, refuse_open, turned_outward
from ctrplan.anatomy.mesh_thinning import thinned, thinning_note
from ctrplan.anatomy.patient_frame import Frame, to_scenario
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface
from ctrplan.storage.toml_table import Table


@dataclass(frozen=True, eq=False)
class SurfaceFile:
    """Vertices (V, 3) [m] in the scenario's frame and triangles (F, 3); notes of what was repaired.

    error_m: what thinning may have moved the surface by.
    """

    vertices_m: Array
    faces: Indices
    notes: tuple[str, ...] = ()
    error_m: float = 0.0


def read_body(
    table: Table, path: Path, unit: str, frame: Frame | None, group: str | None, repair: Repair
) -> SurfaceFile:
    """The closed surface of a body that `table` names, turned outward. Raises InputError."""
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    try:
        vertices, faces = merged(*read_triangles(path, unit, group))
        faces, notes = closed(vertices, faces, repair)
        refuse_open(vertices, faces)
        vertices, faces, error = thinned(vertices, faces)
        faces = turned_outward(vertices, faces)
        return SurfaceFile(_placed(table, path, frame, vertices), faces, (*notes, *thinning_note(faces, error)), error)
    except MeshRefusal as refusal:
        fault = table.fault(str(refusal), "file")
        if refusal.place_m is None:
            raise fault from refusal.__cause__
        raise MeshDefectError(fault, MeshDefect(path, Surface(vertices, faces), refusal.place_m)) from None


def read_sheet(table: Table, path: Path, unit: str, frame: Frame | None, group: str | None) -> SurfaceFile:
    """A surface of any kind that `table` names, open ones as well. Raises InputError."""
    try:
        vertices, faces = merged(*read_triangles(path, unit, group))
    except MeshRefusal as refusal:
        raise table.fault(str(refusal), "file") from refusal.__cause__
    return SurfaceFile(_placed(table, path, frame, vertices), faces)


def _placed(table: Table, path: Path, frame: Frame | None, vertices: Array) -> Array:
    return np.ascontiguousarray(vertices * to_scenario(table, stated_frame(path), frame, is_patient=False))
