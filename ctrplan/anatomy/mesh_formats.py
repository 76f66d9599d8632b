"""Formats of meshes that our own code reads: Wavefront OBJ, binary PLY, binary STL, VTK's legacy and XML files.

A reader gives vertices (V, 3) in the file's unit and triangles (F, 3), counted from 0. Polygons are fanned about their
first corner; points, lines and volumes in the same file are left out. MeshRefusal says what is wrong with a file.
docs/dependencies.md tells which of these files trimesh and meshio refuse or read otherwise.
"""

from __future__ import annotations

import base64
import re
import zlib
from array import array
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal
from ctrplan.base.arrays import Array

Polygons = tuple[Indices, Indices]  # offsets (P + 1,) and corners: the k-th has those from offsets[k] to offsets[k + 1]

NUMBERS = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"int64": "i8", "uint64": "u8", "double": "f8", "float64": "f8", "long": "i8", "unsigned_long": "u8"},
    **{"unsigned_char": "u1", "unsigned_short": "u2", "unsigned_int": "u4", "vtkidtype": "i4", "vtktypeint64": "i8"},
}
STL_HEAD = 1024  # bytes by which text is told
STL_REMAINDER = 134 / 50  # triangles' worth of bytes, in which no further solid would have room
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
BYTE_ORDER_MARK = "\xef\xbb\xbf"  # of UTF-8, read byte by byte
LARGEST_INDEX = 2**62
OBJ_STATEMENTS = {"v": "vertex of three coordinates", "f": "face of three corners and more"}
PLY_ORDERS = {b"binary_little_endian": "<", b"binary_big_endian": ">"}
PLY_CORNERS = ("vertex_indices", "vertex_index")
VTK_FACES = (5, 7, 9)  # cell types: triangle, polygon, quad
VTK_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")


def fanned(offsets: Indices, corners: Indices) -> Indices:
    """Triangles (F, 3) of polygons, about the first corner of each. Raises ValueError."""
    offsets, corners = np.asarray(offsets, np.int64), np.asarray(corners, np.int64)
    counts = np.diff(offsets)
    if len(counts) and (counts.min() < 0 or offsets[0] < 0 or offsets[-1] > len(corners)):
        raise ValueError("its polygons go beyond their corners")
    fans = np.maximum(counts - 2, 0)
    owner = np.repeat(np.arange(len(counts)), fans)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = offsets[:-1][owner]
    return np.stack([corners[first], corners[first + place + 1], corners[first + place + 2]], axis=1)


def _damaged(what: str) -> NoReturn:
    raise MeshRefusal(f"is damaged: {what}")


# STL


def read_binary_stl(path: Path) -> tuple[Array, Indices] | None:
    """The three vertices of each triangle on their own; None for text. trimesh needs three times the memory.

    Binary ones may begin with "solid". A few bytes behind the last triangle are nobody's. Raises MeshRefusal.
    """
    with path.open("rb") as stream:
        head = stream.read(STL_HEAD)
        promised, room = int.from_bytes(head[80:84], "little"), (path.stat().st_size - 84) / 50
        if promised != room:
            if len(head) < 84 or (b"\0" not in head and head.removeprefix(BOM_UTF8)[:5].lower() == b"solid"):
                return None
            if not 0 < promised < room < promised + STL_REMAINDER:
                _damaged(f"its header promises {promised} triangles, its size is that of {room:.10g}")
        records = np.fromfile(path, STL_TRIANGLE, promised, offset=84)
    vertices = records["corners"].astype(np.float64).reshape(-1, 3)
    return vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)


# Wavefront OBJ: `v` and `f` say where the surface is, `g` and `o` what a part of it is called.


def read_obj(path: Path, group: str | None = None) -> tuple[Array, Indices]:
    """The mesh, or one group of it where that is named, in time proportional to the file's size.

    Indices may count backwards from the last vertex so far. Raises MeshRefusal, with the line, for what is no vertex
    or face, and for a group that there is not.
    """
    coordinates, corners, names, groups = array("d"), array("q"), list[str](), Counter[str]()
    with path.open(encoding="latin-1") as lines:  # comments and names may be in any encoding
        for number, line in _joined(lines):
            statement, *words = line.split() or [""]
            try:
                if statement == "v":
                    coordinates.extend(_obj_vertex(words))
                elif statement in ("g", "o"):
                    names = [" ".join(words), *words]
                elif statement == "f":
                    polygon = _obj_polygon(words, len(coordinates) // 3)
                    groups[names[0] if names else "default"] += len(polygon) - 2
                    if group is None or group in names:
                        for b, c in zip(polygon[1:], polygon[2:], strict=False):
                            corners.extend((polygon[0], b, c))
            except (ValueError, OverflowError):
                fault = f"line {number} is no {OBJ_STATEMENTS[statement]}: {' '.join(line.split())[:60]}"
                raise MeshRefusal(f"can't be read as OBJ: {fault}") from None
    if group is not None and not corners:
        listed = ", ".join(f"{name!r} ({count} triangles)" for name, count in list(groups.items())[:12])
        raise MeshRefusal(f"has no group {group!r}, but {listed or 'none'}")
    return np.array(coordinates).reshape(-1, 3), np.array(corners, dtype=np.int64).reshape(-1, 3)


def _joined(lines: Iterator[str]) -> Iterator[tuple[int, str]]:
    """Lines with their numbers from 1; one that ends in a backslash goes on in the next."""
    logical_line, first = "", 0
    for number, line in enumerate(lines, start=1):
        text = line.removeprefix(BYTE_ORDER_MARK) if number == 1 else line
        first = first or number
        if text.rstrip("\n").endswith("\\"):
            logical_line += text.rstrip("\n")[:-1] + " "
            continue
        yield first, logical_line + text if logical_line else text
        logical_line, first = "", 0
    if logical_line:
        yield first, logical_line


def _obj_vertex(words: Sequence[str]) -> tuple[float, float, float]:
    if "_" in "".join(words[:3]):  # Python's own spelling of numbers
        raise ValueError
    x, y, z = map(float, words[:3])  # a weight or a colour may follow
    return x, y, z


def _obj_polygon(words: Sequence[str], vertices: int) -> list[int]:
    """Vertices of a face, from 0; `vertices` are those before it, from which negative ones count backwards."""
    polygon = []
    for word in words:
        counted = int(word.partition("/")[0])  # texture and normal follow
        index = counted - 1 if counted > 0 else vertices + counted
        if "_" in word or counted == 0 or not 0 <= index < LARGEST_INDEX:
            raise ValueError
        polygon.append(index)
    if len(polygon) < 3:
        raise ValueError
    return polygon


# PLY


@dataclass(frozen=True)
class _Property:
    """A number of an element, or a list of them after its length."""

    name: str
    kind: np.dtype[np.generic]
    count: np.dtype[np.generic] | None = None  # of a list: the type of its length


@dataclass(frozen=True)
class _Element:
    """`length` rows of properties."""

    name: str
    length: int
    properties: list[_Property]


def read_binary_ply(data: bytes) -> tuple[Array, Indices] | None:
    """The mesh; None where the file is no binary PLY. Raises MeshRefusal for a header that contradicts what follows."""
    header, mark, body = data.partition(b"end_header")
    lines = [line.strip() for line in header.replace(b"\r", b"\n").split(b"\n") if line.strip()]
    formats = [line.split()[1:2] for line in lines if line.startswith(b"format")]
    if not mark or lines[:1] != [b"ply"] or not formats or (order := PLY_ORDERS.get(b"".join(formats[0]))) is None:
        return None
    body = body[body.find(b"\n") + 1 :]
    place, vertices, faces = 0, np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    for element in _ply_elements(lines, order):
        size = sum(p.kind.itemsize if p.count is None else p.count.itemsize for p in element.properties)
        if place + element.length * size > len(body):
            _damaged(f"it ends before its {element.length} rows of {element.name} do")
        if element.name == "vertex":
            vertices = _ply_vertices(element, body, place)
        if all(p.count is None for p in element.properties):
            place += element.length * size
            continue
        starts, counts, place = _ply_lists(element, body, place)
        if element.name == "face":
            faces = _ply_faces(element, body, starts, counts)
    if place != len(body):
        _damaged(f"{len(body) - place} bytes are left over")
    return vertices, faces


def _ply_elements(lines: Sequence[bytes], order: str) -> list[_Element]:
    elements: list[_Element] = []
    for line in lines[1:]:
        words = line.decode("latin-1").split()
        try:
            if words[0] == "element":
                elements.append(_Element(words[1], int(words[2]), []))
                if elements[-1].length < 0:
                    raise ValueError
            elif words[0] == "property":
                is_list = words[1] == "list"
                kinds = [np.dtype(order + NUMBERS[word]) for word in (words[2:4] if is_list else words[1:2])]
                elements[-1].properties.append(_Property(words[4 if is_list else 2], kinds[-1], *kinds[:-1]))
        except (IndexError, KeyError, ValueError):
            _damaged(f"its header holds the line {' '.join(words)[:60]!r}")
    return elements


def _ply_lists(element: _Element, body: bytes, place: int) -> tuple[Indices, Indices, int]:
    """Where the corners of each row begin, how many there are, and where the element ends."""
    starts, counts, limit = array("q"), array("q"), len(body)
    for row in range(element.length):
        for p in element.properties:
            if p.count is None:
                place += p.kind.itemsize
                continue
            size = p.count.itemsize
            if p.count.kind not in "iu" or place + size > limit:
                _damaged(f"row {row + 1} of {element.name} has no list {p.name}")
            length = int(np.frombuffer(body, p.count, 1, place)[0]) if size > 1 else body[place]
            place += size
            if p.name in PLY_CORNERS:
                starts.append(place)
                counts.append(length)
            place += length * p.kind.itemsize
            if length < 0 or place > limit:
                _damaged(f"row {row + 1} of {element.name} goes beyond its end")
    return np.array(starts, np.int64), np.array(counts, np.int64), place


def _ply_vertices(element: _Element, body: bytes, place: int) -> Array:
    names = [p.name for p in element.properties]
    if any(p.count is not None for p in element.properties) or not {"x", "y", "z"} <= set(names):
        _damaged("its vertices have other properties than x, y and z of one number each")
    if len(set(names)) < len(names):
        _damaged("its vertices have a property twice")
    table = np.frombuffer(body, np.dtype([(p.name, p.kind) for p in element.properties]), element.length, place)
    with np.errstate(invalid="ignore"):  # coordinates that are no numbers are refused with the mesh
        return np.column_stack([table[axis].astype(np.float64) for axis in "xyz"]).reshape(-1, 3)


def _ply_faces(element: _Element, body: bytes, starts: Indices, counts: Indices) -> Indices:
    kind = next((p.kind for p in element.properties if p.name in PLY_CORNERS), None)
    if kind is None or kind.kind not in "iu" or len(starts) != element.length:
        _damaged(f"its faces have no list {PLY_CORNERS[0]} of whole numbers")
    if len(counts) and counts.min() < 3:
        _damaged(f"face {int(counts.argmin()) + 1} has {counts.min()} corners")
    ends = np.cumsum(counts)
    places = np.repeat(starts - kind.itemsize * (ends - counts), counts) + kind.itemsize * np.arange(counts.sum())
    corners = np.frombuffer(body, np.uint8)[places[:, None] + np.arange(kind.itemsize)].view(kind)[:, 0]
    return fanned(np.append(0, ends), corners.astype(np.int64))


# VTK


def read_vtk(path: Path) -> tuple[Array, Indices]:
    """The surface of a legacy .vtk (text or binary, cells old or new), a .vtp or a .vtu. Raises MeshRefusal."""
    data = path.read_bytes().removeprefix(BOM_UTF8)
    try:
        legacy = data.startswith(b"# vtk DataFile")
        points, (offsets, corners) = (_LegacyVtk(data) if legacy else _XmlVtk(data)).surface()
        return points.reshape(-1, 3), fanned(offsets, corners)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, SyntaxError, zlib.error) as error:
        reason = " ".join(str(error).split())[:120]  # SyntaxError: of XML
        raise MeshRefusal(f"can't be read as {path.suffix.upper()[1:]}: {reason}") from error


def _of_faces(offsets: Indices, corners: Indices, types: Indices) -> Polygons:
    """The cells that are faces."""
    counts = np.diff(offsets)
    chosen = np.isin(types, VTK_FACES)
    keep = np.repeat(chosen, counts)
    return np.concatenate([[0], np.cumsum(counts[chosen])]), corners[offsets[0] :][: len(keep)][keep]


class _LegacyVtk:
    """A legacy file, read from its beginning to its end."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0
        self.line(), self.line()
        self.binary = self.line().upper() == "BINARY"

    def surface(self) -> tuple[Array, Polygons]:
        points, cells, types = np.zeros(0), (np.zeros(1, np.int64), np.zeros(0, np.int64)), None
        while (words := self.line().split()) and (word := words[0].upper()) not in ("POINT_DATA", "CELL_DATA"):
            if word == "DATASET" and words[1].upper() not in ("POLYDATA", "UNSTRUCTURED_GRID"):
                raise ValueError(f"it holds {words[1]}, no surface")
            if word == "POINTS":
                points = self.numbers(3 * int(words[1]), words[2]).astype(np.float64)
            elif word in VTK_CELLS:
                polygons = self.cells(int(words[1]), int(words[2]))
                if word == "TRIANGLE_STRIPS" and len(polygons[1]):
                    raise ValueError("it has triangle strips: save it as triangles")
                cells = polygons if word in ("POLYGONS", "CELLS") else cells
            elif word == "CELL_TYPES":
                types = self.numbers(int(words[1]), "int").astype(np.int64)
        return points, cells if types is None else _of_faces(*cells, types)

    def row(self) -> bytes:
        """The bytes up to the end of the line."""
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        row, self.at = self.data[self.at : end], end + 1
        return row

    def line(self) -> str:
        """The next line that is not empty; empty at the end."""
        while self.at < len(self.data):
            if text := self.row().decode("latin-1").strip():
                return text
        return ""

    def numbers(self, count: int, kind: str) -> NDArray[np.generic]:
        """The next `count` numbers, of a type that the file names."""
        dtype = np.dtype(">" + NUMBERS[kind.lower()])
        if self.binary:
            values = np.frombuffer(self.data, dtype, count, self.at)
            self.at += count * dtype.itemsize
            return values
        words: list[bytes] = []
        while len(words) < count and self.at < len(self.data):
            words += self.row().split()
        if len(words) != count:
            raise ValueError(f"it ends before its {count} numbers do")
        return np.array(words, dtype=np.float64 if dtype.kind == "f" else np.int64)

    def cells(self, count: int, size: int) -> Polygons:
        before = self.at
        words = self.line().split()
        if words[:1] == ["OFFSETS"]:
            offsets = self.numbers(count, words[1]).astype(np.int64)
            return offsets, self.numbers(size, self.line().split()[1]).astype(np.int64)
        self.at = before
        return _without_counts(count, self.numbers(size, "int").astype(np.int64))


def _without_counts(count: int, packed: Indices) -> Polygons:
    """Polygons of rows that begin with their length."""
    starts, at = np.empty(count, np.int64), 0
    if count and (packed[: 4 * count : 4] == 3).all() and len(packed) == 4 * count:  # nearly always
        return np.arange(0, 3 * count + 1, 3), packed.reshape(-1, 4)[:, 1:].ravel()
    for row in range(count):
        starts[row] = at
        at += 1 + max(int(packed[at]), 0)
    keep = np.ones(len(packed), bool)
    keep[starts] = False
    return np.append(starts - np.arange(count), at - count), packed[keep]


class _XmlVtk:
    """An XML file: arrays as text, in base64 or appended, packed by zlib or not."""

    def __init__(self, data: bytes) -> None:
        if b"<!" in data[:2000].replace(b"<!--", b""):
            raise ValueError("it declares a document type, which no file of VTK does")
        head, mark, tail = data.partition(b"<AppendedData")
        self.appended, self.encoded = b"", False
        if mark:
            opening, _, body = tail.partition(b">")
            self.encoded = b"base64" in opening
            self.appended = body[body.index(b"_") + 1 : body.rindex(b"</AppendedData")]
            head += b"</VTKFile>"
        self.root = ElementTree.fromstring(head)
        self.order = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        self.header = self.dtype(self.root.get("header_type", "UInt32"))
        self.packer = self.root.get("compressor")
        if self.packer not in (None, "vtkZLibDataCompressor"):
            raise ValueError(f"it is packed by {self.packer}: save it with zlib or unpacked")

    def dtype(self, name: str) -> np.dtype[np.generic]:
        return np.dtype(self.order + NUMBERS[name.lower()])

    def surface(self) -> tuple[Array, Polygons]:
        points, offsets, corners = [np.zeros(0)], [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
        grid = self.root.get("type")
        if grid not in ("PolyData", "UnstructuredGrid"):
            raise ValueError(f"it holds {grid}, no surface")
        for piece in self.root.iter("Piece"):
            if int(piece.get("NumberOfStrips", "0")):
                raise ValueError("it has triangle strips: save it as triangles")
            cells = piece.find("Polys" if grid == "PolyData" else "Cells")
            starts, at = np.append(0, self.named(cells, "offsets")), self.named(cells, "connectivity")
            points.append(self.values(piece.find("Points/DataArray")).astype(np.float64))
            named = "NumberOfPolys" if grid == "PolyData" else "NumberOfCells"
            for name, there in (("NumberOfPoints", len(points[-1]) / 3), (named, len(starts) - 1)):
                if float(piece.get(name, there)) != there:
                    raise ValueError(f"it says {name} = {piece.get(name)}, and has {there:g}")
            if grid == "UnstructuredGrid":
                starts, at = _of_faces(starts, at, self.named(cells, "types"))
            offsets.append(starts[1:] + sum(map(len, corners)))
            corners.append(at + sum(map(len, points[:-1])) // 3)
        return np.concatenate(points), (np.concatenate(offsets), np.concatenate(corners))

    def named(self, cells: ElementTree.Element | None, name: str) -> Indices:
        arrays = [] if cells is None else [values for values in cells if values.get("Name") == name]
        return self.values(arrays[0]).astype(np.int64) if arrays else np.zeros(0, np.int64)

    def values(self, values: ElementTree.Element | None) -> NDArray[np.generic]:
        if values is None:
            raise ValueError("it has no points")
        dtype = self.dtype(values.get("type", ""))
        form, text = values.get("format", "ascii"), values.text or ""
        if form == "ascii":
            return np.array(text.split(), dtype=np.float64 if dtype.kind == "f" else np.int64)
        if form == "binary":
            return np.frombuffer(self.decoded(re.sub(r"\s", "", text).encode()), dtype)
        data = self.appended[int(values.get("offset", "0")) :]
        if self.encoded:
            return np.frombuffer(self.decoded(data.strip()), dtype)
        blocks = 1 if self.packer is None else 3 + int(np.frombuffer(data, self.header, 1)[0])
        return np.frombuffer(self.unpacked(data, self.header.itemsize * blocks), dtype)

    def decoded(self, text: bytes) -> bytes:
        """Content of base64 that may go on; the header of packed data has an ending of its own."""
        size = self.header.itemsize
        if self.packer is None:
            count = int(np.frombuffer(base64.b64decode(text[: _letters(size)]), self.header, 1)[0])
            return base64.b64decode(text[: _letters(size + count)])[size : size + count]
        blocks = int(np.frombuffer(base64.b64decode(text[: _letters(3 * size)])[:size], self.header)[0])
        head = (3 + blocks) * size
        header = base64.b64decode(text[: _letters(head)])[:head]
        total = int(np.frombuffer(header, self.header)[3:].sum())
        body = base64.b64decode(text[_letters(head) :][: _letters(total)])
        return self.unpacked(header + body, head)

    def unpacked(self, data: bytes, begin: int) -> bytes:
        """Content of what has a header that ends at `begin`."""
        header = np.frombuffer(data[:begin], self.header)
        if self.packer is None:
            return data[begin : begin + int(header[0])]
        ends = begin + np.cumsum(header[3:].astype(np.int64))
        return b"".join(zlib.decompress(data[a:b]) for a, b in zip([begin, *ends[:-1]], ends, strict=True))


def _letters(count: int) -> int:
    """Letters of base64 for so many bytes."""
    return 4 * ((count + 2) // 3)
