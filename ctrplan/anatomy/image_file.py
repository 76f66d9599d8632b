"""Reading a volume from a NIfTI, NRRD, MHA or MHD file: checked, or refused in one sentence."""

from __future__ import annotations

import importlib
import locale
import os
import re
import struct
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.image import (
    APART_MM,
    Header,
    Image,
    ImageRefusal,
    Segment,
    UnfitImageRefusal,
    check_length,
    check_packed,
    first_bytes,
    other_kind,
    readable,
    text_header,
    voxel_bytes,
)
from ctrplan.anatomy.patient_frame import TURNED, Frame
from ctrplan.base.arrays import NORM_TOLERANCE, Array

UNITS_MM = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}  # xyzt_units: unknown, metre, millimetre, micrometre
TYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8"}
NO_NUMBERS = {
    **{1: "one bit a voxel: save it with 8 bits", 128: "3 values a voxel (colour?): must have one"},
    **{2304: "4 values a voxel (colour?): must have one", 32: "complex values: must have real ones"},
    **{1792: "complex values: must have real ones", 2048: "complex values: must have real ones"},
    **{1536: "128-bit numbers: save it with 64 bits"},
}
SAME_SIZE = 1e-3  # of two statements of a voxel's size


@dataclass(frozen=True)
class _Layout:
    """Where a NIfTI header has its numbers, and of what types."""

    size: int
    magic: int
    fields: dict[str, tuple[str, int]]


NIFTI_1 = _Layout(
    348,
    344,
    {
        **{"dim": ("8h", 40), "type": ("h", 70), "bits": ("h", 72), "pixdim": ("8f", 76), "offset": ("f", 108)},
        **{"scaling": ("2f", 112), "unit": ("B", 123), "codes": ("2h", 252), "quaternion": ("6f", 256)},
        **{"affine": ("12f", 280)},
    },
)
NIFTI_2 = _Layout(
    540,
    4,
    {
        **{"type": ("h", 12), "bits": ("h", 14), "dim": ("8q", 16), "pixdim": ("8d", 104), "offset": ("q", 168)},
        **{"scaling": ("2d", 176), "codes": ("2i", 344), "quaternion": ("6d", 352), "affine": ("12d", 400)},
        **{"unit": ("i", 500)},
    },
)
LAYOUTS = {layout.size: layout for layout in (NIFTI_1, NIFTI_2)}


@dataclass(frozen=True, eq=False)
class NiftiHeader:
    """What a header says. affine_mm (3, 4): of indices along (x, y, z) to RAS."""

    shape: tuple[int, ...]  # along (x, y, z), and more where there is more
    kind: np.dtype[Any]
    offset: int
    slope: float
    intercept: float
    affine_mm: Array
    notes: tuple[str, ...] = field(default=())

    @property
    def header(self) -> Header:
        """What is compared with a reader."""
        return Header("RAS", notes=self.notes)


def is_nifti(path: Path) -> bool:
    """Whether the name is that of a NIfTI file."""
    return path.name.lower().endswith((".nii", ".nii.gz"))


def nifti_header(path: Path) -> NiftiHeader:
    """The header of a file. Raises ImageRefusal where it is damaged or leaves open where voxels are."""
    head = first_bytes(path, NIFTI_2.size)
    if (other := other_kind(path, head)) is not None:
        raise ImageRefusal(other)
    if len(head) < NIFTI_1.size:
        raise ImageRefusal("is damaged or cut short: it has no whole NIfTI header")
    order = "<" if struct.unpack("<i", head[:4])[0] in LAYOUTS else ">"
    layout = LAYOUTS.get(struct.unpack(order + "i", head[:4])[0])
    if layout is None:
        raise ImageRefusal("is damaged, or no NIfTI file: its header is none of NIfTI")
    if len(head) < layout.size:
        raise ImageRefusal("is damaged or cut short: it has no whole NIfTI header")
    values = {name: struct.unpack_from(order + kind, head, at) for name, (kind, at) in layout.fields.items()}
    _check_magic(head[layout.magic : layout.magic + 3])
    affine, notes = _affine_mm(values)
    if (code := _standard(values["codes"])) is not None:
        notes += (f"says places in a standard brain ({code}), which are the patient's only where it was warped back",)
    slope, intercept = _scaling(*values["scaling"], is_single=layout is NIFTI_1)
    code = values["type"][0]
    if code not in TYPES:
        raise UnfitImageRefusal(f"has {NO_NUMBERS.get(code, f'values of an unknown type, NIfTI code {code}')}")
    bits, due = values["bits"][0], 8 * np.dtype(TYPES[code]).itemsize
    if bits not in (0, due):
        raise ImageRefusal(f"says {bits} bits a voxel (bitpix), and a type of {due} (datatype {code}): they must agree")
    if not np.isfinite(values["offset"][0]):
        raise ImageRefusal("is damaged: it does not say where its voxels begin (vox_offset)")
    start = max(int(values["offset"][0]), layout.size + 4)
    return NiftiHeader(_shape(values["dim"]), np.dtype(order + TYPES[code]), start, slope, intercept, affine, notes)


def nifti_voxels(path: Path, header: NiftiHeader) -> NDArray[Any]:
    """(nz, ny, nx) values as the header scales them. Raises ImageRefusal for a file that is cut short."""
    count = int(np.prod(header.shape))
    due, slices = count * header.kind.itemsize, header.shape[-1]
    data = first_bytes(path, due + due // slices, header.offset)
    check_length(len(data), due, slices, ("dim", "datatype"))
    values = np.frombuffer(data, header.kind, count).reshape(header.shape[::-1])
    return scaled(values.astype(header.kind.newbyteorder("=")), header.slope, header.intercept)


def scaled(values: NDArray[Any], slope: float, intercept: float) -> NDArray[Any]:
    """Stored values as their header means them."""
    if slope == 1 and intercept == 0:
        return values
    result: NDArray[Any] = values.astype(np.float64) * slope + intercept
    return result


def _check_magic(magic: bytes) -> None:
    if magic in (b"ni1", b"ni2"):
        raise ImageRefusal("has its voxels in another file (.img): save both as one .nii file")
    if magic not in (b"n+1", b"n+2"):
        raise ImageRefusal("is an Analyze file or damaged: its header does not have NIfTI's mark n+1, nor the sides")


def _shape(dim: tuple[int, ...]) -> tuple[int, ...]:
    count, *sizes = dim
    if not 1 <= count <= 7 or any(n < 1 for n in sizes[:count]):
        raise ImageRefusal("is damaged: its header has no numbers of voxels (dim)")
    shape = [int(n) for n in sizes[:count]]
    while len(shape) > 3 and shape[-1] == 1:
        shape.pop()
    return tuple(shape)


def _scaling(slope: float, intercept: float, *, is_single: bool) -> tuple[float, float]:
    """Slope and intercept; by the standard a slope of 0 means that nothing is scaled, the intercept neither.

    Single precision stands for the decimal number that it was written as: 0.001, not 0.0010000000475.
    """
    if slope == 0 or not np.isfinite([slope, intercept]).all():
        return 1.0, 0.0
    if is_single:
        return float(str(np.float32(slope))), float(str(np.float32(intercept)))
    return slope, intercept


def _affine_mm(values: dict[str, tuple[Any, ...]]) -> tuple[Array, tuple[str, ...]]:
    """The affine by the sform or the quaternion, which have to agree where the file has both."""
    unit = UNITS_MM.get(int(values["unit"][0]) & 7, 1.0)
    q_code, s_code = values["codes"]
    pixdim = np.array(values["pixdim"], dtype=float)
    sized = bool((np.isfinite(pixdim[1:4]) & (pixdim[1:4] > 0)).all())
    s_form = np.array(values["affine"], dtype=float).reshape(3, 4) * unit if s_code > 0 else None
    if s_form is not None and not (np.isfinite(s_form).all() and np.linalg.norm(s_form[:, :3], axis=0).all()):
        s_form = None
    if q_code <= 0 and s_code <= 0:
        raise ImageRefusal("does not say where the patient's sides are (qform_code and sform_code are 0)")
    if s_form is None and not sized:
        raise ImageRefusal("does not say the size of its voxels (pixdim)")
    q_form = _quaternion_form(values["quaternion"], pixdim) * unit if q_code > 0 and sized else None
    if s_form is None and q_form is None:
        raise ImageRefusal("does not say where its voxels are: its sform is no affine, its qform_code is 0")
    if q_form is None or s_form is None:
        affine = q_form if s_form is None else s_form
        assert affine is not None
        return affine, _size_note(affine, pixdim * unit) if sized else ()
    last = np.array([[0, 0, 0], [n - 1 for n in values["dim"][1:4]]], dtype=float)
    corners = [last @ form[:, :3].T + form[:, 3] for form in (q_form, s_form)]
    apart = float(np.abs(corners[0] - corners[1]).max())
    if apart > max(APART_MM, 1e-4 * np.ptp(corners[1])):
        raise ImageRefusal(f"says two places that lie {apart:.3g} mm apart (qform, sform): save it with one")
    return s_form, ()


def _standard(codes: tuple[int, ...]) -> str | None:
    """The code by which the form that is taken is one of Talairach's or MNI's space; None where it is of a scanner."""
    name, code = ("sform_code", codes[1]) if codes[1] > 0 else ("qform_code", codes[0])
    return f"{name} {code}" if code in (3, 4) else None


def _size_note(affine: Array, pixdim: Array) -> tuple[str, ...]:
    size = np.linalg.norm(affine[:, :3], axis=0)
    if (np.abs(size - pixdim[1:4]) <= SAME_SIZE * size).all():
        return ()
    stated, taken = (" x ".join(f"{s:.3g}" for s in sizes) for sizes in (pixdim[1:4], size))
    return (f"says voxels of {stated} mm in pixdim and of {taken} mm in its sform, which is taken",)


def _quaternion_form(quaternion: tuple[float, ...], pixdim: Array) -> Array:
    """Affine (3, 4) of the header's quaternion and offset, in RAS."""
    b, c, d, *offset = quaternion
    square = b * b + c * c + d * d
    if not square <= 1 + NORM_TOLERANCE:
        raise ImageRefusal("is damaged: its qform has a quaternion that is longer than 1")
    a = np.sqrt(max(0.0, 1.0 - square))
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
        ]
    )
    handed = -1.0 if pixdim[0] < 0 else 1.0
    return np.column_stack([rotation * pixdim[1:4] * (1, 1, handed), offset])


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
SAMPLED = 10_000  # voxels by which most images that are no whole numbers are told: a budget
SKEW = 1e-3


def segments_of(metadata: Mapping[str, str]) -> tuple[Segment, ...]:
    """The segments that the keys of a file name, in their order there; none for any other file."""
    numbers = sorted(int(match[1]) for key in metadata if (match := re.fullmatch(r"Segment(\d+)_LabelValue", key)))
    return tuple(
        Segment(
            metadata.get(f"Segment{k}_Name", metadata.get(f"Segment{k}_ID", str(k))),
            int(metadata[f"Segment{k}_LabelValue"]),
            int(metadata.get(f"Segment{k}_Layer", "0")),
        )
        for k in numbers
    )


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
            raise ImageRefusal(f"can't be read: {reason(error)}") from error
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
    check_bytes(size, reader.GetNumberOfComponents() * (voxel_bytes(pixel) or 4))


def check_bytes(size: tuple[int, ...], voxel_bytes: int) -> None:
    """Raises UnfitImageRefusal for more than MOST_BYTES of voxels."""
    total = float(np.prod(size, dtype=float)) * voxel_bytes
    if total > MOST_BYTES:
        shown = " x ".join(map(str, size))
        rule = f"crop it to the structure and what the robot reaches, at most {MOST_BYTES / 1e9:g} GB"
        raise UnfitImageRefusal(f"holds {shown} voxels, {total / 1e9:.3g} GB: {rule}")


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
