"""Wavefront OBJ files: vertices and faces, in time proportional to their size, whatever groups and materials they name.

Of the format's statements only `v` and `f` say where the surface is, `g` and `o` what a part of it is
called. Indices may count backwards from the last vertex,
polygons are fanned into triangles about their first corner.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal
from ctrplan.base.arrays import Array

BYTE_ORDER_MARK = "\xef\xbb\xbf"  # of UTF-8, read byte by byte
FURTHEST = 2**62


def read_obj(path: Path, group: str | None = None) -> tuple[Array, Indices]:
    """Vertices (V, 3) in the file's unit and triangles (F, 3), counted from 0; of one group where it is named.

    Raises MeshRefusal, with the line, for what is no vertex or face, and for a group that there is not.
    """
    coordinates, corners, names, groups = array("d"), array("q"), list[str](), Counter[str]()
    with path.open(encoding="latin-1") as lines:  # comments and names may be in any encoding
        for number, line in _joined(lines):
            statement, *words = line.split() or [""]
            try:
                if statement == "v":
                    coordinates.extend(_vertex(words))
                elif statement in ("g", "o"):
                    names = [" ".join(words), *words]
                elif statement == "f":
                    triangles = _fan(_indices(words, len(coordinates) // 3))
                    groups[names[0] if names else "default"] += len(triangles) // 3
                    if group is None or group in names:
                        corners.extend(triangles)
            except (ValueError, OverflowError):
                shown = " ".join(line.split())[:60]
                raise MeshRefusal(f"can't be read as OBJ: line {number} is no {_THINGS[statement]}: {shown}") from None
    if group is not None and not corners:
        listed = ", ".join(f"{name!r} ({count} triangles)" for name, count in list(groups.items())[:12])
        raise MeshRefusal(f"has no group {group!r}, but {listed or 'none'}")
    return np.array(coordinates).reshape(-1, 3), np.array(corners, dtype=np.int64).reshape(-1, 3)


_THINGS = {"v": "vertex of three coordinates", "f": "face of three corners and more"}


def _joined(lines: Iterator[str]) -> Iterator[tuple[int, str]]:
    """Lines with their numbers from 1; one that ends in a backslash goes on in the next."""
    begun, first = "", 0
    for number, line in enumerate(lines, start=1):
        text = line.removeprefix(BYTE_ORDER_MARK) if number == 1 else line
        first = first or number
        if text.rstrip("\n").endswith("\\"):
            begun += text.rstrip("\n")[:-1] + " "
            continue
        yield first, begun + text if begun else text
        begun, first = "", 0
    if begun:
        yield first, begun


def _vertex(words: Sequence[str]) -> tuple[float, float, float]:
    if "_" in "".join(words[:3]):  # Python's own spelling of numbers
        raise ValueError
    x, y, z = map(float, words[:3])  # a weight or a colour may follow
    return x, y, z


def _indices(words: Sequence[str], vertices: int) -> list[int]:
    """Vertices of a face, from 0; `vertices` are those before it, from which negative ones count backwards."""
    found = []
    for word in words:
        counted = int(word.partition("/")[0])  # texture and normal follow
        index = counted - 1 if counted > 0 else vertices + counted
        if "_" in word or counted == 0 or not 0 <= index < FURTHEST:
            raise ValueError
        found.append(index)
    if len(found) < 3:
        raise ValueError
    return found


def _fan(corners: Sequence[int]) -> list[int]:
    if len(corners) == 3:
        return list(corners)
    return [k for b, c in zip(corners[1:], corners[2:], strict=False) for k in (corners[0], b, c)]
