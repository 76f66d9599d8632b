"""Reading a volume from a NIfTI, NRRD, MHA or MHD file: checked, or refused in one sentence."""

from __future__ import annotations

import gzip
import importlib
import locale
import os
import struct
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.image import Image, ImageRefusal, UnfitImageRefusal, segments_of
from ctrplan.anatomy.image_header import Header, check_gzip, first_bytes, read_header
from ctrplan.anatomy.patient_frame import TURNED
from ctrplan.base.arrays import Array


def simpleitk() -> Any:
    """The package, its warnings off. Raises ImageRefusal where it is not installed."""
    try:
        package: Any = importlib.import_module("SimpleITK")
    except ImportError as error:
        raise ImageRefusal("needs SimpleITK: pip install ctrplan[images]") from error
    package.ProcessObject.SetGlobalWarningDisplay(False)
    return package


@contextmanager
def quiet() -> Iterator[None]:
    """What its parts print of damaged files besides raising an error is not shown."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


@contextmanager
def kept_locale() -> Iterator[None]:
    """What its reader of DICOM does to the locale is undone: it sets C, after which files are opened as ASCII."""
    kept = locale.setlocale(locale.LC_ALL)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, kept)


def reason(error: Exception) -> str:
    """The last thing that the package says of a failure, in a line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return " ".join((lines[-1] if lines else type(error).__name__).split())[-160:]


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
    data = _nifti_bytes(path, start, count * kind.itemsize)
    if start < SIZE or len(data) < count * kind.itemsize:
        due = f"it has {len(data)} bytes of voxels, {count * kind.itemsize} are due"
        raise ImageRefusal(f"is damaged or cut short: {due}")
    values = np.frombuffer(data, kind, count).reshape(shape[::-1]).astype(kind.newbyteorder("="))
    if slope in (0.0, 1.0) and intercept == 0 or not np.isfinite([slope, intercept]).all():
        return values
    return np.asarray(values * (slope or 1.0) + intercept)


def _nifti_bytes(path: Path, start: int, count: int) -> bytes:
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


SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
MOST_BYTES = 2_000_000_000
SMALLEST_M, LARGEST_M = 1e-3, 4.0  # from the first to the last voxel
FINEST_M, COARSEST_M = 1e-6, 50e-3
SKEW = 1e-3
VOXEL_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8}


def is_image(path: Path) -> bool:
    """Whether the name is that of a volume."""
    return path.name.lower().endswith(SUFFIXES)


def read_image(path: Path) -> Image:
    """The volume. Raises ImageRefusal."""
    sitk, header = simpleitk(), read_header(path)
    if is_nifti_2(head := first_bytes(path, SIZE)):
        return _nifti_2(path, head, header)
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise ImageRefusal(f"can't be read: {reason(error)}") from error
    names = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
    segments = segments_of(names)
    _check_kind(sitk, reader, bool(segments))
    check_gzip(path)
    try:
        with quiet():
            read = reader.Execute()
        return checked(sitk, read, header, segments)
    except RuntimeError as error:
        raise ImageRefusal(f"is damaged or cut short: {reason(error)}") from error


def _nifti_2(path: Path, head: bytes, header: Header) -> Image:
    shape, kind = shape_and_type(head)
    _check_shape(shape)
    check_bytes(shape, kind.itemsize)
    check_gzip(path)
    affine = np.zeros((3, 4)) if header.affine_mm is None else header.affine_mm * 1e-3
    spacing = np.linalg.norm(affine[:, :3], axis=0)
    if not (np.isfinite(affine).all() and (spacing > 0).all()):
        raise ImageRefusal("has a spacing or an origin that is not finite")
    return _checked(read_nifti_2(path, head), spacing, affine[:, 3], affine[:, :3] / spacing, header)


def _check_shape(size: tuple[int, ...]) -> None:
    if len(size) != 3:
        shown = " x ".join(map(str, size))
        what = f"is a time series of {size[3]} volumes, {shown}" if len(size) == 4 else f"is no volume: {shown} voxels"
        raise UnfitImageRefusal(f"{what}: must be one volume of three dimensions")


def _check_kind(sitk: Any, reader: Any, is_segmentation: bool) -> None:
    size, pixel = reader.GetSize(), sitk.GetPixelIDValueAsString(reader.GetPixelID())
    _check_shape(size)
    if reader.GetNumberOfComponents() > 1 and not is_segmentation:
        raise UnfitImageRefusal(f"has {reader.GetNumberOfComponents()} values a voxel (colour?): must have one")
    if "complex" in pixel:
        raise UnfitImageRefusal("has complex values: must have real ones")
    check_bytes(size, reader.GetNumberOfComponents() * _bytes(pixel))


def check_bytes(size: tuple[int, ...], voxel_bytes: int) -> None:
    """Raises UnfitImageRefusal for more than MOST_BYTES of voxels."""
    total = float(np.prod(size, dtype=float)) * voxel_bytes
    if total > MOST_BYTES:
        shown = " x ".join(map(str, size))
        rule = f"crop it to the structure and what the robot reaches, at most {MOST_BYTES / 1e9:g} GB"
        raise UnfitImageRefusal(f"holds {shown} voxels, {total / 1e9:.3g} GB: {rule}")


def _bytes(pixel: str) -> int:
    return next((count for bits, count in VOXEL_BYTES.items() if pixel.split("-")[0].split(" ")[0] == bits), 4)


def checked(sitk: Any, image: Any, header: Header, segments: tuple[Any, ...] = ()) -> Image:
    """SimpleITK's image as ours. Raises ImageRefusal for places or values that are none."""
    direction, spacing = np.array(image.GetDirection()).reshape(3, 3), np.array(image.GetSpacing()) * 1e-3
    origin = np.array(image.GetOrigin()) * 1e-3
    if header.frame == "RAS":  # the reader turns everything to LPS
        origin, direction = TURNED * origin, TURNED[:, None] * direction
    return _checked(sitk.GetArrayFromImage(image), spacing, origin, direction, header, segments)


def _checked(
    voxels: NDArray[Any],
    spacing: Array,
    origin: Array,
    direction: Array,
    header: Header,
    segments: tuple[Any, ...] = (),
) -> Image:
    """The image. Raises ImageRefusal for places or values that are none."""
    if not (np.isfinite(direction).all() and np.abs(direction.T @ direction - np.eye(3)).max() <= SKEW):
        raise ImageRefusal("has axes that are not at right angles: resample it to a straight grid")
    if not (np.isfinite(spacing).all() and np.isfinite(origin).all()):
        raise ImageRefusal("has a spacing or an origin that is not finite")
    image = Image(voxels, spacing, origin, direction, header.frame, segments)
    _check_place(image, header.corners_mm)
    _check_size(image)
    if voxels.dtype.kind == "f" and (bad := int(np.count_nonzero(~np.isfinite(voxels)))):
        raise ImageRefusal(f"has {bad} voxels that are NaN or infinite: all must be finite")
    return image


def _check_place(image: Image, corners_mm: Array | None) -> None:
    """Two readings of one header have to agree, so that no convention of either flips the patient."""
    if corners_mm is None:
        return
    last = np.array([[0, 0, 0], image.size], dtype=float) - [[0, 0, 0], [1, 1, 1]]
    apart = float(np.abs(image.place_m(last) * 1e3 - corners_mm).max())
    if apart > max(0.05, 1e-4 * float(np.ptp(corners_mm))):
        raise ImageRefusal(f"says places that two readings understand {apart:.3g} mm apart: save it with one affine")


def _check_size(image: Image) -> None:
    extent = float((image.spacing_m * image.size).max())
    if not FINEST_M <= image.spacing_m.min() <= image.spacing_m.max() <= COARSEST_M:
        spacing = " x ".join(f"{s * 1e3:.3g}" for s in image.spacing_m)
        raise ImageRefusal(f"has voxels of {spacing} mm: must be {FINEST_M * 1e3:g} to {COARSEST_M * 1e3:g} mm wide")
    if not SMALLEST_M <= extent <= LARGEST_M:
        hint = "metres in a file of millimetres?" if extent < SMALLEST_M else "micrometres?"
        raise ImageRefusal(
            f"is {extent * 1e3:.3g} mm across: must be {SMALLEST_M * 1e3:g} mm to {LARGEST_M:g} m ({hint})"
        )
