"""What the header of an image file says itself of frame, spacing and place, where its reader would keep silent.

A reader fills in what a file leaves open: a spacing of 1 mm, axes along the patient's. Here such files are refused.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ctrplan.anatomy.image import ImageRefusal
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import Array

HEADER_BYTES, PIECE = 1 << 16, 1 << 24
SPACES: dict[str, Frame] = {
    **{"right-anterior-superior": "RAS", "ras": "RAS", "left-posterior-superior": "LPS", "lps": "LPS"},
    **{"left-anterior-superior": "LPS", "las": "LPS"},  # which its reader turns
}
APART_MM = 0.05  # by which two statements of one place may differ
NIFTI_UNITS_MM = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}


@dataclass(frozen=True)
class Header:
    """frame: what the file's coordinates are in, None where it does not say.

    corners_mm: (2, 3) centres of the first and last voxel as this header has them, in that frame; None if unread.
    affine_mm: (3, 4) of indices along (x, y, z) to that frame, of NIfTI.
    """

    frame: Frame | None
    corners_mm: Array | None = None
    affine_mm: Array | None = None


def read_header(path: Path) -> Header:
    """The header of a NIfTI, NRRD, MHA or MHD file. Raises ImageRefusal where it leaves open where voxels are."""
    name = path.name.lower()
    if name.endswith((".nii", ".nii.gz")):
        return _nifti(path)
    if name.endswith((".nrrd", ".nhdr")):
        return _nrrd(_fields(path, ":", b""))
    return _meta(_fields(path, "=", b"ElementDataFile"))


def check_gzip(path: Path) -> None:
    """Raises ImageRefusal for a gzip file that is cut short or damaged, of which readers return what there is."""
    try:
        with path.open("rb") as plain:
            if plain.read(2) != b"\x1f\x8b":
                return
        with gzip.open(path) as packed:
            while packed.read(PIECE):
                pass
    except (EOFError, OSError, zlib.error) as error:
        raise ImageRefusal(f"is damaged or cut short ({' '.join(str(error).split())})") from error


def first_bytes(path: Path, count: int) -> bytes:
    """Those of a file, unpacked. Raises ImageRefusal for one that is damaged."""
    try:
        with path.open("rb") as plain:
            if plain.read(2) != b"\x1f\x8b":
                plain.seek(0)
                return plain.read(count)
        with gzip.open(path) as packed:
            return packed.read(count)
    except (EOFError, OSError, zlib.error) as error:
        raise ImageRefusal(f"is damaged or cut short ({' '.join(str(error).split())})") from error


def _fields(path: Path, mark: str, last: bytes) -> dict[str, str]:
    """Lines "name mark value" of a text header, which ends with the line `last` or an empty one."""
    results: dict[str, str] = {}
    for line in first_bytes(path, HEADER_BYTES).split(b"\n"):
        name, there, value = line.decode("latin-1").strip().partition(mark)
        if there and not name.startswith("#"):
            results[name.strip().lower()] = value.strip(" =\t")
        if (last and line.startswith(last)) or (not last and not line.strip()):
            break
    return results


def _nrrd(fields: dict[str, str]) -> Header:
    if "space directions" not in fields and "spacings" not in fields:
        raise ImageRefusal("does not say the size of its voxels (no space directions, no spacings)")
    return Header(SPACES.get(fields.get("space", "").lower()))


def _meta(fields: dict[str, str]) -> Header:
    if "elementspacing" not in fields and "elementsize" not in fields:
        raise ImageRefusal("does not say the size of its voxels (no ElementSpacing)")
    letters = fields.get("anatomicalorientation", "").upper()
    matrix = fields.get("transformmatrix") or fields.get("rotation") or fields.get("orientation") or "1 0 0 0 1 0 0 0 1"
    if len(letters) != 3 or set(letters) - set("RLAPIS"):
        return Header(None)
    try:
        axes = np.array(matrix.split(), dtype=float).reshape(3, 3)
    except ValueError:
        return Header(None)
    return Header("LPS" if _runs_from(axes) == letters else None)


def _runs_from(axes: Array) -> str:
    """Letters of what each index runs from, for axes (3, 3) in rows in LPS: RAI for the identity.

    Each index goes to one direction of the patient, the closest pairs first, as the writers of such files do it.
    """
    letters, left = ["", "", ""], np.abs(axes)
    for _ in range(3):
        index, side = np.unravel_index(np.argmax(left), left.shape)
        letters[index] = ("RL", "AP", "IS")[side][int(axes[index, side] < 0)]
        left[index], left[:, side] = -1.0, -1.0
    return "".join(letters)


@dataclass(frozen=True)
class _Layout:
    """Where a NIfTI header has its numbers, and of what types."""

    dim: tuple[str, int]
    pixdim: tuple[str, int]
    codes: tuple[str, int]
    quaternion: tuple[str, int]  # b, c, d, and the offset
    affine: tuple[str, int]
    unit: tuple[str, int]

    def read(self, head: bytes, order: str, field: tuple[str, int]) -> tuple[float, ...]:
        """The numbers of a field."""
        kind, offset = field
        return struct.unpack_from(order + kind, head, offset)


NIFTI_1 = _Layout(("8h", 40), ("8f", 76), ("2h", 252), ("6f", 256), ("12f", 280), ("B", 123))
NIFTI_2 = _Layout(("8q", 16), ("8d", 104), ("2i", 344), ("6d", 352), ("12d", 400), ("i", 500))
LAYOUTS = {348: NIFTI_1, 540: NIFTI_2}


def _nifti(path: Path) -> Header:
    head = first_bytes(path, 540)
    if len(head) < 348:
        raise ImageRefusal("is damaged or cut short: it has no whole NIfTI header")
    order = "<" if struct.unpack("<i", head[:4])[0] in LAYOUTS else ">"
    size = struct.unpack(order + "i", head[:4])[0]
    if size not in LAYOUTS:
        raise ImageRefusal("is damaged: its header is none of NIfTI")
    if len(head) < size:
        raise ImageRefusal("is damaged or cut short: it has no whole NIfTI header")
    layout = LAYOUTS[size]
    dim, pixdim = layout.read(head, order, layout.dim), np.array(layout.read(head, order, layout.pixdim))
    q_code, s_code = layout.read(head, order, layout.codes)
    if not (np.isfinite(pixdim[1:4]) & (pixdim[1:4] > 0)).all():
        raise ImageRefusal("does not say the size of its voxels (pixdim)")
    if q_code <= 0 and s_code <= 0:
        raise ImageRefusal("does not say where the patient's sides are (qform_code and sform_code are 0)")
    unit = NIFTI_UNITS_MM.get(int(layout.read(head, order, layout.unit)[0]) & 7, 1.0)
    last = np.array([[0, 0, 0], [n - 1 for n in dim[1:4]]], dtype=float)
    quaternion = layout.read(head, order, layout.quaternion)
    forms = _quaternion_form(quaternion, pixdim) * unit, np.array(layout.read(head, order, layout.affine)) * unit
    q = _corners(forms[0], last) if q_code > 0 else None
    s = _corners(forms[1].reshape(3, 4), last) if s_code > 0 else None
    if q is not None and s is not None and (apart := float(np.abs(q - s).max())) > max(APART_MM, 1e-4 * np.ptp(s)):
        raise ImageRefusal(f"says two places that lie {apart:.3g} mm apart (qform, sform): save it with one")
    return Header("RAS", q if s is None else s, forms[0] if s is None else forms[1].reshape(3, 4))


def _corners(affine: Array, index: Array) -> Array:
    return np.asarray(index @ affine[:, :3].T + affine[:, 3])


def _quaternion_form(quaternion: tuple[float, ...], pixdim: Array) -> Array:
    """Affine (3, 4) of the header's quaternion and offset, in RAS."""
    b, c, d, *offset = quaternion
    a = np.sqrt(max(0.0, 1.0 - (b * b + c * c + d * d)))
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
        ]
    )
    handed = -1.0 if pixdim[0] < 0 else 1.0
    return np.column_stack([rotation * pixdim[1:4] * (1, 1, handed), offset])
