"""Binary PLY files, whose faces may have different numbers of corners: polygons are fanned into triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal
from ctrplan.base.arrays import Array

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
ORDERS = {b"binary_little_endian": "<", b"binary_big_endian": ">"}
END = b"end_header"
CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class Property:
    """A number of an element, or a list of them after its length."""

    name: str
    kind: np.dtype[np.generic]
    count: np.dtype[np.generic] | None = None  # of a list: the type of its length


@dataclass(frozen=True)
class Element:
    """`length` rows of properties."""

    name: str
    length: int
    properties: list[Property]


def read_binary_ply(data: bytes) -> tuple[Array, Indices] | None:
    """Vertices (V, 3) in the file's unit and triangles (F, 3); None where the file is no binary PLY.

    Raises MeshRefusal for a header that says something else than what follows.
    """
    header, mark, body = data.partition(END)
    lines = [line.strip() for line in header.replace(b"\r", b"\n").split(b"\n") if line.strip()]
    formats = [line.split()[1:2] for line in lines if line.startswith(b"format")]
    if not mark or lines[:1] != [b"ply"] or not formats or (order := ORDERS.get(b"".join(formats[0]))) is None:
        return None
    body = body[body.find(b"\n") + 1 :]
    place, vertices, faces = 0, np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    for element in _elements(lines, order):
        starts, counts, end = _rows(element, body, place)
        if element.name == "vertex":
            vertices = _coordinates(element, body, place)
        elif element.name == "face" and starts is not None:
            faces = _triangles(element, body, starts, counts)
        place = end
    if place != len(body):
        _damaged(f"{len(body) - place} bytes are left over")
    return vertices, faces


def _elements(lines: Sequence[bytes], order: str) -> list[Element]:
    found: list[Element] = []
    for line in lines[1:]:
        words = line.decode("latin-1").split()
        try:
            if words[0] == "element":
                found.append(Element(words[1], int(words[2]), []))
                if found[-1].length < 0:
                    raise ValueError
            elif words[0] == "property" and words[1] == "list":
                found[-1].properties.append(Property(words[4], _kind(words[3], order), _kind(words[2], order)))
            elif words[0] == "property":
                found[-1].properties.append(Property(words[2], _kind(words[1], order)))
        except (IndexError, KeyError, ValueError):
            _damaged(f"its header holds the line {' '.join(words)[:60]!r}")
    return found


def _kind(name: str, order: str) -> np.dtype[np.generic]:
    return np.dtype(order + TYPES[name])


def _rows(element: Element, body: bytes, place: int) -> tuple[NDArray[np.int64] | None, NDArray[np.int64], int]:
    """Where the corners of each row begin, how many there are, and where the element ends; None without corners."""
    lists = [p for p in element.properties if p.count is not None]
    if not lists:
        end = place + element.length * sum(p.kind.itemsize for p in element.properties)
        if end > len(body):
            _damaged(f"it ends before its {element.length} rows of {element.name} do")
        return None, np.zeros(0, np.int64), end
    return _rows_with_lists(element, body, place)


def _rows_with_lists(element: Element, body: bytes, place: int) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    starts, counts, limit = [], [], len(body)
    if element.length > limit:  # a row has a byte at least
        _damaged(f"it ends before its {element.length} rows of {element.name} do")
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
            if p.name in CORNERS:
                starts.append(place)
                counts.append(length)
            place += length * p.kind.itemsize
            if length < 0 or place > limit:
                _damaged(f"row {row + 1} of {element.name} goes beyond its end")
    return np.array(starts, np.int64), np.array(counts, np.int64), place


def _coordinates(element: Element, body: bytes, place: int) -> Array:
    if any(p.count is not None for p in element.properties) or not {"x", "y", "z"} <= {
        p.name for p in element.properties
    }:
        _damaged("its vertices have other properties than x, y and z of one number each")
    try:
        row = np.dtype([(p.name, p.kind) for p in element.properties])
    except ValueError:
        _damaged("its vertices have a property twice")
    table = np.frombuffer(body, row, element.length, place)
    return np.column_stack([table[axis].astype(np.float64) for axis in "xyz"]).reshape(-1, 3)


def _triangles(element: Element, body: bytes, starts: NDArray[np.int64], counts: NDArray[np.int64]) -> Indices:
    """Fans of all faces, those of as many corners together."""
    kind = next((p.kind for p in element.properties if p.name in CORNERS), None)
    if kind is None or kind.kind not in "iu" or len(starts) != element.length:
        _damaged(f"its faces have no list {CORNERS[0]} of whole numbers")
    if len(counts) and counts.min() < 3:
        _damaged(f"face {int(counts.argmin()) + 1} has {counts.min()} corners")
    content, fans = np.frombuffer(body, np.uint8), [np.zeros((0, 3), np.int64)]
    for count in np.unique(counts).tolist():
        at = starts[counts == count][:, None] + np.arange(count * kind.itemsize)
        corners = content[at].view(kind).astype(np.int64)
        fans += [corners[:, [0, k, k + 1]] for k in range(1, count - 1)]
    return np.concatenate(fans)


def _damaged(what: str) -> NoReturn:
    raise MeshRefusal(f"is damaged: {what}")
