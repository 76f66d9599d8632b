"""A volume, and what the header of its file says where readers do not.

That is frame, units, spacing, place and scaling. A reader fills in what a file leaves open (a spacing of 1 mm, an
origin of 0, axes along the patient's) and passes over what it does not know (centimetres, a scaling of the values).
Here the first is refused and the second is applied.
"""

from __future__ import annotations

import bz2
import gzip
import math
import re
import tempfile
import zlib
from codecs import BOM_UTF8
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.package import shown
from ctrplan.storage.csv_table import HEAD_BYTES, other_than_named, packed_by


class ImageRefusal(Exception):
    """A rule that a volume breaks, as the end of a sentence; whoever reads it says where it was named."""


class UnfitImageRefusal(ImageRefusal):
    """Refuses an image that is whole, but too large or of a kind that is not read: it may lie beside what is meant."""


@dataclass(frozen=True)
class Segment:
    """A name that a segmentation gives to a label, in one of its layers."""

    name: str
    label: int
    layer: int = 0


@shown
@dataclass(frozen=True, eq=False)
class Image:
    """Voxels (nz, ny, nx), or (nz, ny, nx, layers); voxel (i, j, k) along (x, y, z) has its centre at `place_m`.

    frame: in which the places are said; None where the file does not tell.
    """

    voxels: NDArray[Any]
    spacing_m: Array  # (3,)
    origin_m: Array  # (3,) centre of voxel (0, 0, 0)
    direction: Array  # (3, 3) orthonormal columns: where i, j and k grow
    frame: Frame | None
    segments: tuple[Segment, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def place_m(self, index: Array) -> Array:
        """(N, 3) [m] of indices (N, 3) along (x, y, z), which need not be whole."""
        return np.asarray(self.origin_m + (index * self.spacing_m) @ self.direction.T)

    @property
    def size(self) -> tuple[int, int, int]:
        """Voxels along (x, y, z)."""
        nz, ny, nx = self.voxels.shape[:3]
        return nx, ny, nz

    @property
    def voxel_mm3(self) -> float:
        """Volume of a voxel."""
        return float(np.prod(self.spacing_m * MM_PER_M))


HEADER_BYTES, PIECE, LARGEST_SIZE = 1 << 16, 1 << 24, 1 << 40
SPACES: dict[str, Frame] = {
    **{"right-anterior-superior": "RAS", "ras": "RAS", "left-posterior-superior": "LPS", "lps": "LPS"},
    **{"left-anterior-superior": "LPS", "las": "LPS"},  # which its reader turns
}
TURNED_SPACES = ("left-anterior-superior", "las")
APART_MM = 0.05  # by which two statements of one place may differ
UNITS_MM = {"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "centimeter": 10.0, "centimetre": 10.0}
UNITS_MM |= {"m": 1e3, "meter": 1e3, "metre": 1e3, "um": 1e-3, "\u00b5m": 1e-3, "\u03bcm": 1e-3, "micron": 1e-3}
UNITS_MM |= {"micrometer": 1e-3, "micrometre": 1e-3, "nm": 1e-6, "in": 25.4, "inch": 25.4}
META, MINC = ((".mha", ".mhd"), "a MetaImage file"), ((), "an HDF5 file (MINC?)")
KINDS: dict[bytes, tuple[tuple[str, ...], str]] = {b"NRRD": ((".nrrd", ".nhdr"), "a NRRD file")}
KINDS |= {b"ObjectType": META, b"NDims": META, b"\x89HDF": MINC}


@dataclass(frozen=True)
class Header:
    """frame: what the file's coordinates are in, None where it does not say.

    corners_mm: (2, 3) centres of the first and last voxel as this header has them, in that frame; None if unread.
    unit_mm: what its reader takes for 1 mm. slope, intercept: of stored values, where its reader leaves them as stored.
    """

    frame: Frame | None
    corners_mm: Array | None = None
    unit_mm: float = 1.0
    slope: float = 1.0
    intercept: float = 0.0
    notes: tuple[str, ...] = ()


def text_header(path: Path) -> Header:
    """The header of a NRRD, MHA or MHD file. Raises ImageRefusal where it leaves open where voxels are."""
    head = first_bytes(path, HEADER_BYTES)
    if (other := other_kind(path, head)) is not None:
        raise ImageRefusal(other)
    if head.startswith(BOM_UTF8):
        raise ImageRefusal("begins with a byte order mark, which an editor wrote: save its header without")
    if path.name.lower().endswith((".nrrd", ".nhdr")):
        if not head.startswith(b"NRRD"):
            raise ImageRefusal("is no NRRD file: its first line does not say so")
        end = _nrrd_end(head)
        fields = _fields(head[:end], ":")
        check_voxel_bytes(path, end, fields, NRRD_VOXELS)
        return _nrrd(fields)
    match = re.search(rb"(?m)^[ \t]*ElementDataFile.*\r?\n?", head)
    end = match.end() if match else len(head)
    fields = _fields(head[:end], "=")
    check_voxel_bytes(path, end, fields, META_VOXELS)
    return _meta(fields)


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """The bytes of a file, unpacked where gzip or bzip2 packed it. Raises ImageRefusal for one that is damaged."""
    try:
        with path.open("rb") as plain:
            kind = packed_by(plain.read(8))
        if kind in ("zip", "xz", "zstd"):
            raise ImageRefusal(f"is packed by {kind}: unpack it first")
        opener: Any = {"gzip": gzip.open, "bzip2": bz2.open}.get(kind or "", open)
        with opener(path, "rb") as stream:
            yield stream
    except (EOFError, OSError, ValueError, zlib.error) as error:
        raise ImageRefusal(f"is damaged or cut short ({' '.join(str(error).split())})") from error


def check_packed(path: Path) -> None:
    """Raises ImageRefusal for a packed file that is cut short or damaged, of which readers return what there is."""
    with opened(path) as stream:
        if isinstance(stream, (gzip.GzipFile, bz2.BZ2File)):
            while stream.read(PIECE):
                pass


def first_bytes(path: Path, count: int, start: int = 0) -> bytes:
    """At most so many bytes of a file, unpacked, from `start`. Raises ImageRefusal for one that is damaged."""
    with opened(path) as stream:
        stream.seek(start)
        return bytes(stream.read(count))


@contextmanager
def readable(path: Path) -> Iterator[Path]:
    """The file, or another one with the same image where its reader can't unpack it. Raises ImageRefusal.

    A whole file may be packed, and the voxels of a NRRD file by bzip2.
    """
    head = first_bytes(path, HEADER_BYTES)
    with path.open("rb") as stream:
        is_packed = packed_by(stream.read(8)) is not None
    is_nrrd = path.suffix.lower() in (".nrrd", ".nhdr")
    end = _nrrd_end(head) if is_nrrd else 0
    encoding = re.search(rb"(?im)^encoding:[ \t]*(bzip2|bz2)[ \t]*\r?$", head[:end]) if is_nrrd else None
    if not is_packed and encoding is None:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder, opened(path) as stream:
        whole = stream.read()
        if encoding is not None:
            whole = _without_bzip2(path, whole, end, encoding.span(1))
        result = Path(folder) / f"image{path.suffix}"
        result.write_bytes(whole)
        yield result


def _nrrd_end(head: bytes) -> int:
    """Where the header of a NRRD file ends: behind its empty line."""
    match = re.search(rb"\r?\n\r?\n", head)
    return match.end() if match else len(head)


def _without_bzip2(path: Path, whole: bytes, end: int, encoding: tuple[int, int]) -> bytes:
    """A NRRD file with its voxels as they are, in it or in one file beside it."""
    head, packed = whole[:end], whole[end:]
    head = head[: encoding[0]] + b"raw" + head[encoding[1] :]
    apart = re.search(rb"(?im)^data ?file:[ \t]*(\S.*?)[ \t]*\r?\n", head)
    try:
        if apart:
            packed = (path.parent / apart[1].decode()).read_bytes()
            head = head[: apart.start()] + head[apart.end() :]
        return head.rstrip(b"\r\n") + b"\n\n" + bz2.decompress(packed)
    except (OSError, ValueError, EOFError) as error:
        raise ImageRefusal(f"is damaged or cut short: bzip2 says {' '.join(str(error).split())}") from error


def other_kind(path: Path, head: bytes) -> str | None:
    """What a file with these first bytes is, and what it must be called; None where they may be what its name says."""
    if (other := other_than_named(head[:HEAD_BYTES])) is not None:
        return other
    if head[128:132] == b"DICM":
        return "is a DICOM file by its first bytes: name the folder of its series"
    start, name = head.removeprefix(BOM_UTF8).lstrip(), path.name.lower()
    for mark, (suffixes, what) in KINDS.items():
        if start.startswith(mark) and not name.endswith(suffixes):
            return f"is {what} by its first bytes" + (f": its name must end in {suffixes[0]}" if suffixes else "")
    return None


def _fields(head: bytes, mark: str) -> dict[str, str]:
    """Lines "name mark value" of a text header; "name:=value" of a NRRD file is a remark of its writer, no field."""
    try:
        text = head.decode()
    except UnicodeDecodeError:
        text = head.decode("latin-1")
    results: dict[str, str] = {}
    for line in text.split("\n"):
        name, there, value = line.strip().partition(mark)
        if there and not name.startswith("#") and not (mark == ":" and value.startswith("=")):
            key = name.strip().lower()
            first = results.setdefault(key, value.strip())
            if mark == "=" and key != "comment" and first.split() != value.split():  # NRRD's reader refuses it itself
                raise ImageRefusal(f"says {name.strip()} twice, and differently: leave the wrong line out")
    return results


class VoxelKeys(NamedTuple):
    """Fields of a text header that say how many bytes its voxels are."""

    sizes: str
    kind: str
    data_file: str
    plain: Mapping[str, tuple[str, ...]]  # values by which the bytes are the voxels, one by one; "": left out


SKIPS: dict[str, tuple[str, ...]] = {name: ("", "0") for name in ("byte skip", "byteskip", "line skip", "lineskip")}
NRRD_VOXELS = VoxelKeys("sizes", "type", "data file", {"encoding": ("raw",)} | SKIPS)
META_PLAIN: dict[str, tuple[str, ...]] = {"compresseddata": ("false", ""), "binarydata": ("true", "")}
META_PLAIN |= {"headersize": ("",), "elementnumberofchannels": ("1", "")}
META_VOXELS = VoxelKeys("DimSize", "ElementType", "ElementDataFile", META_PLAIN)
VOXEL_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8, "char": 1, "short": 2, "double": 8, "float": 4}
VOXEL_BYTES |= {"longlong": 8, "long_long": 8, "long long": 8, "int": 4}  # in this order: "short int" is short


def voxel_bytes(kind: str) -> int | None:
    """Bytes of a number by the words that a header has for its type; None for words of another kind."""
    return next((count for name, count in VOXEL_BYTES.items() if name in kind.lower()), None)


def _data_file(fields: Mapping[str, str], keys: VoxelKeys) -> str:
    return fields.get(keys.data_file.lower()) or fields.get("datafile") or "LOCAL"


def data_files(path: Path) -> list[Path]:
    """Files with the voxels of a header (.mhd, .nhdr), in its folder or below; nothing of any other file."""
    mark, keys = {".mhd": ("=", META_VOXELS), ".nhdr": (":", NRRD_VOXELS)}.get(path.suffix.lower(), ("", None))
    if keys is None or (name := _data_file(_fields(first_bytes(path, HEADER_BYTES), mark), keys)).upper() == "LOCAL":
        return []
    there = [path.parent / name] if (path.parent / name).is_file() else sorted(path.parent.iterdir())
    return [part for part in there if part.is_file() and part != path]


def check_voxel_bytes(path: Path, end: int, fields: Mapping[str, str], keys: VoxelKeys) -> None:
    """Raises ImageRefusal where a header that ends at `end` is followed by other voxels than it states.

    Its readers take as many bytes as the header makes, whatever there is, and of slices in several files what is there.
    """
    named = _data_file(fields, keys)
    if named.upper().startswith("LIST") or "%" in named:
        if keys is META_VOXELS:
            raise ImageRefusal(f"has its slices in several files ({keys.data_file} = {named}): save it as one file")
        return
    file, start = (path, end) if named.upper() == "LOCAL" else (path.parent / named, 0)
    if not file.resolve().is_relative_to(path.parent.resolve()):
        raise ImageRefusal(f"has its voxels outside its folder, in {named} ({keys.data_file}): put both side by side")
    if not file.is_file():
        raise ImageRefusal(f"has its voxels in another file, {named}, which is not beside it ({keys.data_file})")
    plain = all(fields.get(name, "").lower() in values for name, values in keys.plain.items())
    each = voxel_bytes(fields.get(keys.kind.lower(), ""))
    with file.open("rb") as stream:
        is_packed = packed_by(stream.read(8)) is not None
    if not plain or each is None or is_packed:
        return
    sizes = np.minimum(_numbers(fields, keys.sizes), LARGEST_SIZE).astype(int).tolist()
    check_length(file.stat().st_size - start, each * math.prod(sizes), sizes[-1], (keys.sizes, keys.kind))


def check_length(there: int, due: int, slices: int, keys: tuple[str, ...]) -> None:
    """Raises ImageRefusal for fewer bytes than a header makes of `keys`, or more by a slice: some may fill a block."""
    if there < due:
        raise ImageRefusal(f"is damaged or cut short: it has {there} bytes of voxels, {due} are due")
    if there >= due + max(1, due // max(1, slices)):
        what = " and ".join(keys)
        raise ImageRefusal(f"has {there} bytes of voxels or more, its header makes {due} of {what}: they must agree")


def _numbers(fields: Mapping[str, str], key: str, count: int | None = None) -> Array:
    """Finite numbers of a field. Raises ImageRefusal that names it."""
    text, result = fields.get(key.lower(), ""), np.array([np.nan])
    with suppress(ValueError):
        result = np.array(text.split(), dtype=np.float64)
    if not len(result) or not np.isfinite(result).all() or count not in (None, len(result)):
        rule = f"must be {count or ''}{' ' if count else ''}numbers with a decimal point, and blanks between them"
        raise ImageRefusal(f"says {key} = {text[:60]}: {rule}")
    return result


OTHER_NAMES = {name.replace(" ", ""): name for name in ("axis mins", "axis maxs", "old min", "old max")}
OTHER_NAMES["centers"] = "centerings"


def _nrrd(header: dict[str, str]) -> Header:
    fields = {OTHER_NAMES.get(name, name): value for name, value in header.items()}
    if not {"space directions", "spacings"} & set(fields):
        raise ImageRefusal("does not say the size of its voxels (no space directions, no spacings)")
    if "space origin" not in fields and ("space directions" in fields or "axis mins" not in fields):
        raise ImageRefusal("does not say where its first voxel is (no space origin)")
    space = fields.get("space", "").lower()
    unit = _unit(fields, "space units" if "space directions" in fields else "units")
    was = "says that its values were made of others (old min, old max): thresholds are of the values it holds"
    notes = (was,) if "old min" in fields or "old max" in fields else ()
    corners = _nrrd_corners(fields) if "space directions" in fields else _straight_corners(fields)
    if corners is not None:
        corners = corners * unit * ((1, -1, 1) if space in TURNED_SPACES else (1, 1, 1))
    return Header(SPACES.get(space), corners, unit, notes=notes)


def unit_mm(word: str) -> float | None:
    """Millimetres in a unit that is written out or not, in the plural or not; None for no unit of length."""
    singular = (word, word.removesuffix("s"), word.removesuffix("es")) if len(word) > 3 else (word,)  # "ms" is a time
    return next((UNITS_MM[name] for name in singular if name in UNITS_MM), None)


def _unit(fields: dict[str, str], key: str) -> float:
    """Millimetres in the unit that a field names for each axis. Raises ImageRefusal for several and unknown ones."""
    words = [word.strip() for word in re.findall(r'"([^"]*)"', fields.get(key, ""))] or fields.get(key, "").split()
    named = {word.lower() for word in words if word not in ("", "???", "none")} or {"mm"}
    units = {unit_mm(word) for word in named}
    if None in units or len(units) > 1:
        raise ImageRefusal(f"has places in {', '.join(sorted(named))} ({key}): must be mm, cm, m or um for all axes")
    return float(units.pop() or 1.0)


def _nrrd_corners(fields: dict[str, str]) -> Array | None:
    """(2, 3) first and last voxel in the file's unit and axes; None where it has no directions in space."""
    try:
        vectors = re.findall(r"none|\(([^)]*)\)", fields["space directions"])
        axes = np.array([[float(x) for x in v.split(",")] for v in vectors if v])
        sizes = [int(n) for n, v in zip(fields["sizes"].split(), vectors, strict=True) if v]
        origin = np.array([float(x) for x in fields["space origin"].strip("() ").split(",")])
        finite = np.isfinite(axes).all() and np.isfinite(origin).all()
    except KeyError:
        return None
    except ValueError:
        finite = False
    if not finite:
        contents = f"says space directions = {fields['space directions'][:60]}, and an origin"
        raise ImageRefusal(f"{contents}: must be three finite numbers each, as (0.5,0,0)")
    if axes.shape != (3, 3) or origin.shape != (3,):
        return None
    return np.stack([origin, origin + (np.array(sizes) - 1) @ axes])


def _straight_corners(fields: dict[str, str]) -> Array | None:
    """(2, 3) first and last voxel by spacings and axis mins, in the file's unit; None where there is a space origin.

    An axis begins at the first voxel's centre (node) or half a voxel before it (cell). Raises ImageRefusal.
    """
    if "space origin" in fields or len(sizes := _numbers(fields, "sizes")) != 3:
        return None
    spacing, mins = (_numbers(fields, name, 3) for name in ("spacings", "axis mins"))
    centers = set(fields.get("centerings", "").lower().split())
    if "axis maxs" in fields:
        steps = (_numbers(fields, "axis maxs", 3) - mins) / spacing
        fits = {kind for kind, n in (("cell", sizes), ("node", sizes - 1)) if np.allclose(steps, n, atol=0.01)}
        if not fits & (centers or fits):
            raise ImageRefusal("says two sizes of its voxels, by axis mins and maxs and by spacings: they must agree")
        centers = centers or fits & {"cell"}  # which readers take where the file says none
    if centers not in ({"cell"}, {"node"}):
        rule = "does not say whether axis mins is where the first voxel begins or its centre (centerings)"
        raise ImageRefusal(f"{rule}: say cell or node for all axes, or save it with space directions")
    first = mins + (spacing / 2 if centers == {"cell"} else 0.0)
    return np.stack([first, first + (sizes - 1) * spacing])


PLACES, TURNS = ("Offset", "Position", "Origin"), ("TransformMatrix", "Rotation", "Orientation")
META_SLOPE, META_OFFSET = "ElementToIntensityFunctionSlope", "ElementToIntensityFunctionOffset"


def _meta(fields: dict[str, str]) -> Header:
    if "elementspacing" not in fields and "elementsize" not in fields:
        raise ImageRefusal("does not say the size of its voxels (no ElementSpacing)")
    if not any(name.lower() in fields for name in PLACES):
        raise ImageRefusal("does not say where its first voxel is (no Offset)")
    letters = fields.get("anatomicalorientation", "").upper()
    for names in (PLACES, TURNS):
        named = [name for name in names if name.lower() in fields]
        for name in named[1:]:
            if not np.allclose(_numbers(fields, name), _numbers(fields, named[0])):
                raise ImageRefusal(f"says {named[0]} and {name}, which differ: save it with one")
    matrix = next((fields[name.lower()] for name in TURNS if name.lower() in fields), "1 0 0 0 1 0 0 0 1")
    unit = _unit(fields, "distanceunits")
    if len(sizes := _numbers(fields, "DimSize")) != 3:  # which is refused as it is
        return Header(None, unit_mm=unit)
    known = {"slope": "1", "intercept": "0"} | {"matrix": matrix} | fields
    slope = _numbers(known, META_SLOPE if META_SLOPE.lower() in fields else "slope", 1)[0]
    intercept = _numbers(known, META_OFFSET if META_OFFSET.lower() in fields else "intercept", 1)[0]
    axes = _numbers(known, "matrix", 9).reshape(3, 3)
    origin = _numbers(fields, next(name for name in PLACES if name.lower() in fields), 3)
    named = [name for name in ("ElementSpacing", "ElementSize") if name.lower() in fields]
    spacing, size = (_numbers(fields, name, 3) for name in (named[0], named[-1]))
    corners = np.stack([origin, origin + ((sizes - 1) * spacing) @ axes]) * unit
    if _numbers({"centerofrotation": "0"} | fields, "CenterOfRotation").any() and not np.allclose(axes, np.eye(3)):
        raise ImageRefusal("turns about a point of its own (CenterOfRotation): save it with Offset alone")
    has_letters = len(letters) == 3 and not set(letters) - set("RLAPIS")
    frame: Frame | None = "LPS" if has_letters and _runs_from(axes) == letters else None
    notes: tuple[str, ...] = ()
    if not np.allclose(np.abs(spacing), np.abs(size), rtol=1e-3):
        notes = (
            "says voxels of one size (ElementSize) and of another distance (ElementSpacing): the distance is taken",
        )
    if has_letters and frame is None:
        rule = (
            f"says sides by letters (AnatomicalOrientation = {letters}) that its axes (TransformMatrix) do not run from"
        )
        notes += (f"{rule}: the letters are passed over",)
    return Header(frame, corners, unit, slope or 1.0, intercept, notes)


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
