"""VTK's XML files of surfaces (.vtp, .vtu): arrays as text, in base64 or appended, packed by zlib or not."""

from __future__ import annotations

import base64
import binascii
import re
import zlib
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

FACES = (5, 7, 9)  # cell types: triangle, polygon, quad
TYPES = {f"{name}{8 * size}": f"{name[0].lower()}{size}" for name in ("Int", "UInt", "Float") for size in (1, 2, 4, 8)}
Indices = NDArray[np.int64]


def read_vtk_xml(data: bytes) -> tuple[Array, Indices, Indices]:
    """Points, and offsets and corners of polygons. Raises ValueError or KeyError for what is none."""
    if b"<!" in data[:2000].replace(b"<!--", b""):
        raise ValueError("it declares a document type, which no file of VTK does")
    try:
        return _Xml(data).surface()
    except (ElementTree.ParseError, binascii.Error, zlib.error, AttributeError, TypeError) as error:
        raise ValueError(str(error)) from error


class _Xml:
    def __init__(self, data: bytes) -> None:
        head, mark, tail = data.partition(b"<AppendedData")
        self.appended, self.encoded = b"", False
        if mark:
            opening, _, body = tail.partition(b">")
            self.encoded = b"base64" in opening
            self.appended = body[body.index(b"_") + 1 : body.rindex(b"</AppendedData")]
            head += b"</VTKFile>"
        self.root = ElementTree.fromstring(head)
        self.order = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        self.header = np.dtype(self.order + TYPES[self.root.get("header_type", "UInt32")])
        self.packer = self.root.get("compressor")
        if self.packer not in (None, "vtkZLibDataCompressor"):
            raise ValueError(f"it is packed by {self.packer}: save it with zlib or unpacked")

    def surface(self) -> tuple[Array, Indices, Indices]:
        points, offsets, corners = [np.zeros(0)], [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
        grid = self.root.get("type")
        if grid not in ("PolyData", "UnstructuredGrid"):
            raise ValueError(f"it holds {grid}, no surface")
        for piece in self.root.iter("Piece"):
            if int(piece.get("NumberOfStrips", "0")):
                raise ValueError("it has triangle strips: save it as triangles")
            cells = piece.find("Polys" if grid == "PolyData" else "Cells")
            ends, at = self._named(cells, "offsets"), self._named(cells, "connectivity")
            starts = np.concatenate([[0], ends])
            if grid == "UnstructuredGrid":
                chosen = np.isin(self._named(cells, "types"), FACES)
                counts, keep = np.diff(starts), np.repeat(chosen, np.diff(starts))
                starts, at = np.concatenate([[0], np.cumsum(counts[chosen])]), at[: len(keep)][keep]
            before = sum(map(len, points)) // 3
            offsets.append(starts[1:] + sum(map(len, corners)))
            corners.append(at + before)
            points.append(self._values(piece.find("Points/DataArray")).astype(np.float64))
        return np.concatenate(points), np.concatenate(offsets), np.concatenate(corners)

    def _named(self, cells: ElementTree.Element | None, name: str) -> Indices:
        arrays = [] if cells is None else [array for array in cells if array.get("Name") == name]
        return self._values(arrays[0]).astype(np.int64) if arrays else np.zeros(0, np.int64)

    def _values(self, array: ElementTree.Element | None) -> NDArray[np.generic]:
        if array is None:
            raise ValueError("it has no points")
        dtype = np.dtype(self.order + TYPES[array.get("type", "")])
        form, text = array.get("format", "ascii"), array.text or ""
        if form == "ascii":
            return np.array(text.split(), dtype=np.float64 if dtype.kind == "f" else np.int64)
        if form == "binary":
            return np.frombuffer(self._decoded(re.sub(r"\s", "", text).encode()), dtype)
        return np.frombuffer(self._at(int(array.get("offset", "0"))), dtype)

    def _at(self, offset: int) -> bytes:
        data = self.appended[offset:]
        if self.encoded:
            return self._decoded(data.strip())
        return self._unpacked(data, self.header.itemsize * self._header_items(data))

    def _decoded(self, text: bytes) -> bytes:
        """Of base64 that may go on; the header of packed data has an ending of its own."""
        size = self.header.itemsize
        if self.packer is None:
            count = int(np.frombuffer(base64.b64decode(text[: _letters(size)]), self.header, 1)[0])
            return base64.b64decode(text[: _letters(size + count)])[size : size + count]
        blocks = int(np.frombuffer(base64.b64decode(text[: _letters(3 * size)])[:size], self.header)[0])
        head = (3 + blocks) * size
        header = base64.b64decode(text[: _letters(head)])[:head]
        total = int(np.frombuffer(header, self.header)[3:].sum())
        body = base64.b64decode(text[_letters(head) :][: _letters(total)])
        return self._unpacked(header + body, head)

    def _header_items(self, data: bytes) -> int:
        return 1 if self.packer is None else 3 + int(np.frombuffer(data, self.header, 1)[0])

    def _unpacked(self, data: bytes, begin: int) -> bytes:
        header = np.frombuffer(data[:begin], self.header)
        if self.packer is None:
            return data[begin : begin + int(header[0])]
        ends = begin + np.cumsum(header[3:].astype(np.int64))
        return b"".join(zlib.decompress(data[a:b]) for a, b in zip([begin, *ends[:-1]], ends, strict=True))


def _letters(count: int) -> int:
    """Letters of base64 for so many bytes."""
    return 4 * ((count + 2) // 3)
