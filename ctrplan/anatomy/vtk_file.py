"""VTK's own files of surfaces: legacy .vtk (text and binary, old and new cells), .vtp and .vtu.

Polygons are fanned into triangles; points, lines and volumes in the same file are left out. meshio reads no PolyData,
which is what surfaces are saved as.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal
from ctrplan.anatomy.vtk_xml import read_vtk_xml
from ctrplan.base.arrays import Array

FACES = (5, 7, 9)  # cell types: triangle, polygon, quad
TYPES = {
    **{"float": "f4", "double": "f8", "char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2"},
    **{"int": "i4", "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "vtkidtype": "i4", "vtktypeint64": "i8"},
}
CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")


def read_vtk(path: Path) -> tuple[Array, Indices]:
    """Vertices (V, 3) in the file's unit and triangles (F, 3). Raises MeshRefusal."""
    data = path.read_bytes()
    kind = path.suffix.upper()[1:]
    try:
        legacy = data.startswith(b"# vtk DataFile")
        points, offsets, corners = _Legacy(data).surface() if legacy else read_vtk_xml(data)
        return points.reshape(-1, 3), fanned(offsets, corners)
    except (ValueError, KeyError, IndexError, OverflowError) as error:
        raise MeshRefusal(f"can't be read as {kind}: {' '.join(str(error).split())[:120]}") from error


def fanned(offsets: Indices, corners: Indices) -> Indices:
    """Triangles (F, 3) of polygons, the k-th from offsets[k] to offsets[k + 1] of the corners, about their first."""
    offsets, corners = np.asarray(offsets, np.int64), np.asarray(corners, np.int64)
    counts = np.diff(offsets)
    if len(counts) and (counts.min() < 0 or offsets[0] < 0 or offsets[-1] > len(corners)):
        raise ValueError("its polygons go beyond their corners")
    fans = np.maximum(counts - 2, 0)
    owner = np.repeat(np.arange(len(counts)), fans)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = offsets[:-1][owner]
    return np.stack([corners[first], corners[first + place + 1], corners[first + place + 2]], axis=1)


class _Legacy:
    """A legacy file, read from its beginning to its end."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0
        self.line(), self.line()
        self.binary = self.line().upper() == "BINARY"

    def line(self) -> str:
        """The next line that is not empty; empty at the end."""
        while self.at < len(self.data):
            end = self.data.find(b"\n", self.at)
            end = len(self.data) if end < 0 else end
            text, self.at = self.data[self.at : end].decode("latin-1").strip(), end + 1
            if text:
                return text
        return ""

    def numbers(self, count: int, kind: str) -> NDArray[np.generic]:
        """As many numbers of a type that the file names."""
        dtype = np.dtype(">" + TYPES[kind.lower()])
        if self.binary:
            found = np.frombuffer(self.data, dtype, count, self.at)
            self.at += count * dtype.itemsize
            return found
        words: list[bytes] = []
        while len(words) < count and self.at < len(self.data):
            end = self.data.find(b"\n", self.at)
            end = len(self.data) if end < 0 else end
            words += self.data[self.at : end].split()
            self.at = end + 1
        if len(words) != count:
            raise ValueError(f"it ends before its {count} numbers do")
        return np.array(words, dtype=np.float64 if dtype.kind == "f" else np.int64)

    def surface(self) -> tuple[Array, Indices, Indices]:
        """Points, and offsets and corners of the polygons."""
        points, cells, types = np.zeros(0), (np.zeros(1, np.int64), np.zeros(0, np.int64)), None
        while words := self.line().split():
            word = words[0].upper()
            if word == "POINTS":
                points = self.numbers(3 * int(words[1]), words[2]).astype(np.float64)
            elif word in CELLS:
                found = self._cells(int(words[1]), int(words[2]))
                if word == "TRIANGLE_STRIPS" and len(found[1]):
                    raise ValueError("it has triangle strips: save it as triangles")
                cells = found if word in ("POLYGONS", "CELLS") else cells
            elif word == "CELL_TYPES":
                types = self.numbers(int(words[1]), "int").astype(np.int64)
            elif word in ("POINT_DATA", "CELL_DATA"):
                break
        return (points, *(cells if types is None else of_faces(*cells, types)))

    def _cells(self, count: int, size: int) -> tuple[Indices, Indices]:
        before = self.at
        words = self.line().split()
        if words[:1] == ["OFFSETS"]:
            offsets = self.numbers(count, words[1]).astype(np.int64)
            return offsets, self.numbers(size, self.line().split()[1]).astype(np.int64)
        self.at = before
        return _unpacked(count, self.numbers(size, "int").astype(np.int64))


def _unpacked(count: int, packed: Indices) -> tuple[Indices, Indices]:
    """Offsets and corners of rows that begin with their length."""
    starts, at = np.empty(count, np.int64), 0
    if count and (packed[: 4 * count : 4] == 3).all() and len(packed) == 4 * count:  # nearly always
        return np.arange(0, 3 * count + 1, 3), packed.reshape(-1, 4)[:, 1:].ravel()
    for row in range(count):
        starts[row] = at
        at += 1 + max(int(packed[at]), 0)
    keep = np.ones(len(packed), bool)
    keep[starts] = False
    return np.append(starts - np.arange(count), at - count), packed[keep]


def of_faces(offsets: Indices, corners: Indices, types: Indices) -> tuple[Indices, Indices]:
    """The cells that are faces."""
    counts = np.diff(offsets)
    chosen = np.isin(types, FACES)
    keep = np.repeat(chosen, counts)
    return np.concatenate([[0], np.cumsum(counts[chosen])]), corners[offsets[0] :][: len(keep)][keep]
