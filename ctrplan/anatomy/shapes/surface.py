"""A sheet to keep away from: a wall, a membrane, a surface with neither inside nor outside."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

from ctrplan.anatomy.mesh_file import Unit, Up
from ctrplan.anatomy.parts import TriangleTree
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.anatomy.shape import PartEntry, register
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.storage.toml_document import TomlTable


@shown
@dataclass(frozen=True, eq=False)
class Sheet(Mesh):
    """vertices_m (V, 3), faces (F, 3) of an open surface; distances to it are never negative."""

    kind = "surface"

    def distance(self, points_m: Array) -> Array:
        if self not in _trees:
            _trees[self] = TriangleTree(self.vertices_m, self.faces)
        return _trees[self].distance(points_m)


@register(Sheet)
class SheetEntry(PartEntry):
    """kind = "surface"."""

    file: str
    unit: Unit | None = None  # of glTF m, of other files to be said
    up: Up | None = None  # the axis that is turned up to z: y of glTF, else z
    frame: Frame | None = None
    group: str | None = None

    def shape(self, table: TomlTable) -> Sheet:
        from ctrplan.anatomy.surface_file import MeshChoice, read_sheet  # slow to import; many scenarios need no meshes

        if self.role != "avoid":
            raise table.fault("must be 'avoid': a sheet has no inside", "role")
        file = table.file(self.file, "file")
        result = read_sheet(table, file, MeshChoice(self.unit, self.up, self.frame, self.group))
        return Sheet(result.vertices_m, result.faces, str(file), result.notes, result.error_m)


_trees: WeakKeyDictionary[Sheet, TriangleTree] = WeakKeyDictionary()  # cannot be pickled with it
