"""Voxels of a NIfTI-2 file, which SimpleITK does not read: after the header they stand as they are, x fastest."""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.images.image import ImageRefusal

SIZE = 540
MAGIC = b"n+2\0"
TYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8"}
DATA_TYPE, DIM, OFFSET, SCALING = ("h", 12), ("8q", 16), ("q", 168), ("2d", 176)


def is_nifti_2(head: bytes) -> bool:
    """Whether the first bytes of a file are those of NIfTI-2, in either order."""
    return len(head) >= 4 and SIZE in struct.unpack("<i", head[:4]) + struct.unpack(">i", head[:4])


def shape_and_type(head: bytes) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Voxels along each axis, those of length 1 at the end left out, and their type. Raises ImageRefusal."""
    order = "<" if struct.unpack("<i", head[:4])[0] == SIZE else ">"
    code = _read(head, order, DATA_TYPE)[0]
    count, *dim = _read(head, order, DIM)
    if head[4:8] != MAGIC or not 1 <= count <= 7 or any(n < 1 for n in dim[:count]):
        raise ImageRefusal("is damaged, or has its voxels in another file: its header is none of NIfTI-2")
    if code not in TYPES:
        raise ImageRefusal(f"has values of NIfTI's type {code} (colour, complex?): must have one real number a voxel")
    shape = [int(n) for n in dim[:count]]
    while len(shape) > 3 and shape[-1] == 1:
        shape.pop()
    return tuple(shape), np.dtype(order + TYPES[code])


def read_nifti_2(path: Path, head: bytes) -> NDArray[Any]:
    """(nz, ny, nx) values as the header scales them. Raises ImageRefusal for a file that is cut short."""
    order = "<" if struct.unpack("<i", head[:4])[0] == SIZE else ">"
    shape, kind = shape_and_type(head)
    slope, intercept = _read(head, order, SCALING)
    start, count = int(_read(head, order, OFFSET)[0]), int(np.prod(shape))
    data = _bytes(path, start, count * kind.itemsize)
    if start < SIZE or len(data) < count * kind.itemsize:
        due = f"it has {len(data)} bytes of voxels, {count * kind.itemsize} are due"
        raise ImageRefusal(f"is damaged or cut short: {due}")
    values = np.frombuffer(data, kind, count).reshape(shape[::-1]).astype(kind.newbyteorder("="))
    if slope in (0.0, 1.0) and intercept == 0 or not np.isfinite([slope, intercept]).all():
        return values
    return np.asarray(values * (slope or 1.0) + intercept)


def _bytes(path: Path, start: int, count: int) -> bytes:
    try:
        with path.open("rb") as plain:
            packed = plain.read(2) == b"\x1f\x8b"
        with gzip.open(path) if packed else path.open("rb") as stream:
            stream.seek(start)
            return bytes(stream.read(count))
    except (EOFError, OSError, ValueError, zlib.error) as error:
        raise ImageRefusal(f"is damaged or cut short ({' '.join(str(error).split())})") from error


def _read(head: bytes, order: str, field: tuple[str, int]) -> tuple[Any, ...]:
    kind, offset = field
    return struct.unpack_from(order + kind, head, offset)
