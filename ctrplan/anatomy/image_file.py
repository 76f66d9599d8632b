"""Reading a volume from a NIfTI, NRRD, MHA or MHD file: checked, or refused in one sentence."""

from __future__ import annotations

import importlib
import locale
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.image import (
    Header,
    Image,
    ImageRefusal,
    UnfitImageRefusal,
    check_packed,
    first_bytes,
    other_kind,
    readable,
    segments_of,
    text_header,
)
from ctrplan.anatomy.nifti import is_nifti, nifti_header, nifti_voxels, scaled
from ctrplan.anatomy.patient_frame import TURNED, Frame
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


SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
MOST_BYTES = 2_000_000_000
SMALLEST_M, LARGEST_M = 1e-3, 4.0  # from the first to the last voxel
FINEST_M, COARSEST_M = 1e-6, 50e-3
ROUNDING, LARGEST_WHOLE = 1e-6, 1e9  # of single precision, with room for a scaling; what is taken for whole numbers
SAMPLED = 10_000
SKEW = 1e-3
VOXEL_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8}


def is_image(path: Path) -> bool:
    """Whether the name is that of a volume."""
    return path.name.lower().endswith(SUFFIXES)


def stated_image_frame(path: Path) -> Frame | None:
    """The frame that the header of a NIfTI, NRRD, MHA or MHD file says. Raises ImageRefusal for a damaged one."""
    return nifti_header(path).header.frame if is_nifti(path) else text_header(path).frame


def read_image(path: Path) -> Image:
    """The volume. Raises ImageRefusal."""
    if is_nifti(path):
        return _nifti(path)
    sitk, header = simpleitk(), text_header(path)
    check_packed(path)
    with readable(path) as file:
        reader = sitk.ImageFileReader()
        reader.SetFileName(str(file))
        try:
            reader.ReadImageInformation()
        except RuntimeError as error:
            raise ImageRefusal(other_kind(first_bytes(path, 512)) or f"can't be read: {reason(error)}") from error
        names = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
        segments = segments_of(names)
        _check_kind(sitk, reader, bool(segments))
        try:
            with quiet():
                read = reader.Execute()
        except RuntimeError as error:
            raise ImageRefusal(f"is damaged or cut short: {reason(error)}") from error
    return checked(sitk, read, header, segments)


def _nifti(path: Path) -> Image:
    head = first_bytes(path, 512)
    if (other := other_kind(head)) is not None:
        raise ImageRefusal(other)
    header = nifti_header(path)
    _check_shape(header.shape)
    check_bytes(header.shape, header.kind.itemsize)
    check_packed(path)
    affine = header.affine_mm * 1e-3
    spacing = np.linalg.norm(affine[:, :3], axis=0)
    if not (np.isfinite(affine).all() and (spacing > 0).all()):
        raise ImageRefusal("has a spacing or an origin that is not finite")
    voxels = nifti_voxels(path, header)
    return placed(voxels, spacing, affine[:, 3], affine[:, :3] / spacing, header.header)


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
    direction = np.array(image.GetDirection()).reshape(3, 3)
    spacing, origin = (np.array(mm) * 1e-3 * header.unit_mm for mm in (image.GetSpacing(), image.GetOrigin()))
    if header.frame == "RAS":  # the reader turns everything to LPS
        origin, direction = TURNED * origin, TURNED[:, None] * direction
    voxels = scaled(sitk.GetArrayFromImage(image), header.slope, header.intercept)
    return placed(voxels, spacing, origin, direction, header, segments)


def placed(
    voxels: NDArray[Any],
    spacing: Array,
    origin: Array,
    direction: Array,
    header: Header,
    segments: tuple[Any, ...] = (),
) -> Image:
    """The image of voxels whose axes are the columns of `direction`, all in SI.

    Values that are whole but for the rounding of a scaling become whole, so that labels are found. Raises ImageRefusal
    for places or values that are none.
    """
    if not (np.isfinite(direction).all() and np.abs(direction.T @ direction - np.eye(3)).max() <= SKEW):
        raise ImageRefusal("has axes that are not at right angles: resample it to a straight grid")
    if not (np.isfinite(spacing).all() and np.isfinite(origin).all()):
        raise ImageRefusal("has a spacing or an origin that is not finite")
    if voxels.dtype.kind == "f" and (bad := int(np.count_nonzero(~np.isfinite(voxels)))):
        raise ImageRefusal(f"has {bad} voxels that are NaN or infinite: all must be finite")
    image = Image(whole_numbers(voxels), spacing, origin, direction, header.frame, segments, header.notes)
    _check_place(image, header.corners_mm)
    _check_size(image)
    return image


def whole_numbers(voxels: NDArray[Any]) -> NDArray[Any]:
    """Values of a floating type as whole numbers where all of them are, within ROUNDING of themselves."""
    if voxels.dtype.kind != "f":
        return voxels
    some = voxels.ravel()[:: max(1, voxels.size // SAMPLED)]  # most images that are not whole are told by these
    for values in (some, voxels):
        nearest = np.rint(values)
        if (np.abs(values - nearest) > ROUNDING * np.maximum(1.0, np.abs(nearest))).any():
            return voxels
    if np.abs(nearest).max(initial=0.0) > LARGEST_WHOLE:
        return voxels
    return np.asarray(nearest.astype(np.int32))


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
