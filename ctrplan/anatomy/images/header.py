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

from ctrplan.anatomy.images.image import ImageRefusal
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
    """

    frame: Frame | None
    corners_mm: Array | None = None


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


def _first_bytes(path: Path, count: int) -> bytes:
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
    found: dict[str, str] = {}
    for line in _first_bytes(path, HEADER_BYTES).split(b"\n"):
        name, there, value = line.decode("latin-1").strip().partition(mark)
        if there and not name.startswith("#"):
            found[name.strip().lower()] = value.strip(" =\t")
        if (last and line.startswith(last)) or (not last and not line.strip()):
            break
    return found


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


def _nifti(path: Path) -> Header:
    head = _first_bytes(path, 540)
    if len(head) < 348:
        raise ImageRefusal("is damaged or cut short: it has no whole NIfTI header")
    order = "<" if struct.unpack("<i", head[:4])[0] in (348, 540) else ">"
    size = struct.unpack(order + "i", head[:4])[0]
    if size == 540:
        return Header("RAS")  # NIfTI-2: where it is, is left to its reader
    if size != 348:
        raise ImageRefusal("is damaged: its header is none of NIfTI")
    dim = struct.unpack(order + "8h", head[40:56])
    pixdim = np.array(struct.unpack(order + "8f", head[76:108]))
    q_code, s_code = struct.unpack(order + "2h", head[252:256])
    if not (np.isfinite(pixdim[1:4]) & (pixdim[1:4] > 0)).all():
        raise ImageRefusal("does not say the size of its voxels (pixdim)")
    if q_code <= 0 and s_code <= 0:
        raise ImageRefusal("does not say where the patient's sides are (qform_code and sform_code are 0)")
    unit = NIFTI_UNITS_MM.get(head[123] & 7, 1.0)
    last = np.array([[0, 0, 0], [n - 1 for n in dim[1:4]]], dtype=float)
    q = _corners(_quaternion_form(head, order, pixdim), last) * unit if q_code > 0 else None
    s = (
        _corners(np.array(struct.unpack(order + "12f", head[280:328])).reshape(3, 4), last) * unit
        if s_code > 0
        else None
    )
    if q is not None and s is not None and (apart := float(np.abs(q - s).max())) > max(APART_MM, 1e-4 * np.ptp(s)):
        raise ImageRefusal(f"says two places that lie {apart:.3g} mm apart (qform, sform): save it with one")
    corners = s if s is not None else q
    return Header("RAS", corners)


def _corners(affine: Array, index: Array) -> Array:
    return np.asarray(index @ affine[:, :3].T + affine[:, 3])


def _quaternion_form(head: bytes, order: str, pixdim: Array) -> Array:
    """Affine (3, 4) of the header's quaternion, in RAS."""
    b, c, d, *offset = struct.unpack(order + "6f", head[256:280])
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
