"""A closed triangle mesh from a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.anatomy.mesh_repair import MeshRefusal, merged, refuse_open, turned_outward
from ctrplan.anatomy.parts import TriangleTree
from ctrplan.anatomy.shape import PartShape, register
from ctrplan.anatomy.surface_file import OfMeshFile, read_body
from ctrplan.base.arrays import Array, lengths, numbers, read_only
from ctrplan.base.package import shown
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError
from ctrplan.storage.toml_document import TomlTable

SURELY = 1 + 1e-6  # beyond rounding
Indices = NDArray[np.int64]


@shown
@dataclass(frozen=True, eq=False)
class Mesh(PartShape):
    """vertices_m (V, 3), faces (F, 3) of a closed surface, in the anatomy's frame; turned outward where they are not.

    Corners that coincide are one. file: where it came from, for messages. notes: what was repaired. surface_error_m:
    what thinning moved it by. Raises InputError for malformed or non-finite arrays, and where the surface is open or
    bounds nothing.
    """

    kind = "mesh"
    is_closed: ClassVar[bool] = True
    vertices_m: Array
    faces: Indices
    file: str | None = None
    notes: tuple[str, ...] = ()
    surface_error_m: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices_m", _points("vertices_m", self.vertices_m))
        object.__setattr__(self, "faces", _triangles("faces", self.faces))
        if self.faces.max() >= len(self.vertices_m):
            raise InputError(f"must hold vertex indices below {len(self.vertices_m)}", key="faces")
        try:
            vertices, faces = merged(self.vertices_m, self.faces)
            if self.is_closed:
                refuse_open(vertices, faces)
                faces = turned_outward(vertices, faces)
        except MeshRefusal as refusal:
            raise InputError(str(refusal), key="faces") from refusal.__cause__
        object.__setattr__(self, "vertices_m", read_only(vertices))
        object.__setattr__(self, "faces", read_only(faces))

    def distance(self, points_m: Array) -> Array:
        if self not in _distances:
            _distances[self] = _MeshDistance(self)
        return _distances[self](points_m)

    def box(self) -> tuple[Array, Array]:
        return self.vertices_m.min(axis=0), self.vertices_m.max(axis=0)

    def surface(self) -> Surface:
        return Surface(self.vertices_m, self.faces)

    @property
    def name(self) -> str:
        return self.file.replace("\\", "/").rsplit("/", 1)[-1] if self.file else self.kind

    def content(self) -> Sequence[ArrayLike]:
        return self.vertices_m, self.faces  # where they came from changes no distance


@register(Mesh)
class MeshEntry(OfMeshFile):
    """kind = "mesh"."""

    repair: Literal["off", "holes", "caps"] = "holes"

    def shape(self, table: TomlTable) -> Mesh:
        return Mesh(*read_body(table, table.file(self.file, "file"), self, self.repair))


class _MeshDistance:
    """Signed distance to a closed mesh: that to its triangles, with the sign of the fast winding number.

    Where bodies of one mesh overlap, a point in the overlap has winding number 2 and is inside as it should be. The
    sign of a run of points is that of its first one: each is nearer to the next one than surfaces are to both.
    """

    def __init__(self, mesh: Mesh) -> None:
        import igl

        self.tree, self.winding = TriangleTree(mesh.vertices_m, mesh.faces), igl.FastWindingNumberBVH()
        self.winding.init(mesh.vertices_m, mesh.faces)

    def __call__(self, points_m: Array) -> Array:
        distance = self.tree.distance(points_m)
        steps = lengths(np.diff(points_m, axis=0))
        begins = np.append(True, distance[1:] + distance[:-1] <= steps * SURELY)[: len(distance)]
        inside = np.asarray(self.winding.winding_number(points_m[begins])) > 0.5
        np.negative(distance, where=inside[np.cumsum(begins) - 1], out=distance)
        return distance


# Trees are expensive, so each lives as long as its mesh does; they can't be pickled with it.
_distances: WeakKeyDictionary[Mesh, _MeshDistance] = WeakKeyDictionary()


def _points(name: str, value: Any) -> Array:
    array = np.ascontiguousarray(numbers(value, name))
    if array.ndim != 2 or array.shape[1] != 3 or not array.size or not np.isfinite(array).all():
        raise InputError("must hold points of three finite coordinates", key=name, unit="m")
    return read_only(array)


def _triangles(name: str, value: Any) -> Indices:
    given = numbers(value, name)
    if not np.all(np.abs(given) < 2**53) or np.any(given != np.round(given)):
        raise InputError("must hold whole numbers", key=name)
    array = np.ascontiguousarray(given, dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 3 or not array.size or array.min() < 0:
        raise InputError("must hold triangles of three vertex indices", key=name)
    return read_only(array)
