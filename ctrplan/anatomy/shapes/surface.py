"""A sheet to keep away from: a wall, a membrane, a surface with neither inside nor outside."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

from ctrplan.anatomy.parts import TriangleTree
from ctrplan.anatomy.shape import register
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.surface_file import OfMeshFile, read_sheet
from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.storage.toml_document import TomlTable


@shown
@dataclass(frozen=True, eq=False)
class Sheet(Mesh):
    """vertices_m (V, 3), faces (F, 3) of an open surface; distances to it are never negative."""

    kind = "surface"
    is_closed = False

    def distance(self, points_m: Array) -> Array:
        if self not in _trees:
            _trees[self] = TriangleTree(self.vertices_m, self.faces)
        return _trees[self].distance(points_m)


@register(Sheet)
class SheetEntry(OfMeshFile):
    """kind = "surface"."""

    def shape(self, table: TomlTable) -> Sheet:
        if self.role != "avoid":
            raise table.fault("must be 'avoid': a sheet has no inside", "role")
        return Sheet(*read_sheet(table, table.file(self.file, "file"), self))


_trees: WeakKeyDictionary[Sheet, TriangleTree] = WeakKeyDictionary()  # cannot be pickled with it
