"""NIfTI-1 and NIfTI-2 files by their standard: header, frame, scaling and voxels, packed or not.

SimpleITK's reader is not asked: it takes the spacing from pixdim where the sform alone says it, scales by a slope of
0, and gives label 3 as 3.0000002 where stored numbers are scaled by 0.001.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.image import APART_MM, Header, ImageRefusal, UnfitImageRefusal, first_bytes, unpacked_bytes
from ctrplan.base.arrays import Array

UNITS_MM = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}  # xyzt_units: unknown, metre, millimetre, micrometre
TYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8"}
NO_NUMBERS = {
    **{1: "one bit a voxel: save it with 8 bits", 128: "3 values a voxel (colour?): must have one"},
    **{2304: "4 values a voxel (colour?): must have one", 32: "complex values: must have real ones"},
    **{1792: "complex values: must have real ones", 2048: "complex values: must have real ones"},
    **{1536: "128-bit numbers: save it with 64 bits"},
}
QUATERNION_TOLERANCE = 1e-3  # by which b^2 + c^2 + d^2 of a header may exceed 1
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
        **{"dim": ("8h", 40), "type": ("h", 70), "pixdim": ("8f", 76), "offset": ("f", 108), "scaling": ("2f", 112)},
        **{"unit": ("B", 123), "codes": ("2h", 252), "quaternion": ("6f", 256), "affine": ("12f", 280)},
    },
)
NIFTI_2 = _Layout(
    540,
    4,
    {
        **{"type": ("h", 12), "dim": ("8q", 16), "pixdim": ("8d", 104), "offset": ("q", 168), "scaling": ("2d", 176)},
        **{"codes": ("2i", 344), "quaternion": ("6d", 352), "affine": ("12d", 400), "unit": ("i", 500)},
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
    slope, intercept = _scaling(*values["scaling"], is_single=layout is NIFTI_1)
    code = values["type"][0]
    if code not in TYPES:
        raise UnfitImageRefusal(f"has {NO_NUMBERS.get(code, f'values of an unknown type, NIfTI code {code}')}")
    start = max(int(values["offset"][0]), layout.size + 4)
    return NiftiHeader(_shape(values["dim"]), np.dtype(order + TYPES[code]), start, slope, intercept, affine, notes)


def nifti_voxels(path: Path, header: NiftiHeader) -> NDArray[Any]:
    """(nz, ny, nx) values as the header scales them. Raises ImageRefusal for a file that is cut short."""
    count = int(np.prod(header.shape))
    data = unpacked_bytes(path, header.offset, count * header.kind.itemsize)
    if len(data) < count * header.kind.itemsize:
        due = f"it has {len(data)} bytes of voxels, {count * header.kind.itemsize} are due"
        raise ImageRefusal(f"is damaged or cut short: {due}")
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


def _size_note(affine: Array, pixdim: Array) -> tuple[str, ...]:
    size = np.linalg.norm(affine[:, :3], axis=0)
    if (np.abs(size - pixdim[1:4]) <= SAME_SIZE * size).all():
        return ()
    said, taken = (" x ".join(f"{s:.3g}" for s in sizes) for sizes in (pixdim[1:4], size))
    return (f"says voxels of {said} mm in pixdim and of {taken} mm in its sform, which is taken",)


def _quaternion_form(quaternion: tuple[float, ...], pixdim: Array) -> Array:
    """Affine (3, 4) of the header's quaternion and offset, in RAS."""
    b, c, d, *offset = quaternion
    square = b * b + c * c + d * d
    if not square <= 1 + QUATERNION_TOLERANCE:
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
