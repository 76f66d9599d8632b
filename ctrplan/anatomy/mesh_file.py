"""Reading triangle meshes from files of several formats: checked, repaired, or refused in one sentence."""

import re
import warnings
from os import PathLike
from pathlib import Path
from typing import TypeVar, cast

import numpy as np
import trimesh
from numpy.typing import NDArray

from ctrplan.anatomy.binary_ply import read_binary_ply
from ctrplan.anatomy.glb_file import read_glb
from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal, turned_outward, welded
from ctrplan.anatomy.obj_file import read_obj
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.anatomy.vtk_file import read_vtk
from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.storage.csv_table import file_name

Number = TypeVar("Number", np.float64, np.int64)

UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 25.4e-3}
SUFFIXES = (".stl", ".ply", ".obj", ".vtk", ".vtp", ".vtu", ".glb")
WITH_GROUPS = (".obj", ".glb")
MAX_BYTES = 500_000_000
HEADER_BYTES = 4096
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
LARGEST_M, SMALLEST_M = 2.0, 1e-4


def load_mesh(
    path: str | PathLike[str], unit: str = "mm", *, file: str | None = None, key: str | None = None
) -> tuple[Array, Indices]:
    """Read a closed mesh: vertices (V, 3) [m] and triangles (F, 3) that wind outward. Several bodies are fine.

    unit: of the file's coordinates, one of UNITS_M. file, key: the scenario file and the key in it that named the mesh,
    for messages.
    Repaired: vertices less than 1 um apart are merged, repeated and collapsed triangles dropped, winding made
    consistent and outward. A shell within another one stays a cavity if the file winds it the other way round.
    Raises InputError, one sentence, for everything else: see the rules in this file.
    """
    name = file_name(path, "a mesh")
    try:
        vertices, faces = welded(*read_triangles(Path(name), unit))
        return vertices, turned_outward(vertices, faces)
    except MeshRefusal as refusal:
        if file is None and key is None:
            raise InputError(str(refusal), file=name) from refusal.__cause__
        raise InputError(str(refusal), file=file, key=key, value=name) from refusal.__cause__


def read_triangles(path: Path, unit: str, group: str | None = None) -> tuple[Array, Indices]:
    """Vertices (V, 3) [m] and triangles (F, 3) as they are in a file, or in a group of it. Raises MeshRefusal."""
    vertices, faces = _read(path, group)
    if unit not in UNITS_M:
        raise MeshRefusal(f"can't be read in unit {unit!r}: must be one of {', '.join(UNITS_M)}")
    vertices = vertices * UNITS_M[unit]
    _check_size(vertices, faces, unit)
    return vertices, faces


def stated_frame(path: Path) -> Frame | None:
    """The patient's frame that a file names, as 3D Slicer does near the beginning; None where it does not."""
    with path.open("rb") as stream:
        found = re.search(rb"SPACE\s*=\s*(RAS|LPS)\b", stream.read(HEADER_BYTES))
    return None if found is None else cast(Frame, found[1].decode())


def _read(path: Path, group: str | None) -> tuple[Array, Indices]:
    if path.suffix.lower() not in SUFFIXES:
        raise MeshRefusal(f"is not a mesh: must end in {', '.join(SUFFIXES)}")
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise MeshRefusal("is not a file")
        if size > MAX_BYTES:
            raise MeshRefusal(f"is {size / 1e6:.0f} MB large: must be at most {MAX_BYTES / 1e6:.0f} MB")
        with path.open("rb"):
            pass
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or str(error)
        raise MeshRefusal(f"can't be read: {reason.lower()}") from error
    if group is not None and path.suffix.lower() not in WITH_GROUPS:
        raise MeshRefusal(f"has no groups: leave the key group out, {' and '.join(WITH_GROUPS)} may have them")
    vertices, faces = _parsed(path, group)
    if not len(faces):
        raise MeshRefusal("is empty: holds no triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshRefusal(f"is damaged: a triangle refers to a vertex beyond the {len(vertices)} there are")
    return vertices, faces


def _parsed(path: Path, group: str | None) -> tuple[Array, Indices]:
    # Processing stays off: it would drop NaN vertices silently. Materials are never looked up.
    kind = path.suffix.lower()[1:]
    if kind == "obj":
        return read_obj(path, group)
    if kind in ("vtk", "vtp", "vtu"):
        return read_vtk(path)
    if kind == "ply" and (found := read_binary_ply(path.read_bytes())) is not None:
        return found
    if kind == "stl":
        _check_stl_size(path)
        if (triangles := _binary_stl(path)) is not None:
            return triangles
    try:
        with warnings.catch_warnings(), path.open("rb") as stream:
            warnings.simplefilter("ignore")
            if kind == "glb":
                return read_glb(stream, group)
            mesh = trimesh.load(stream, file_type=kind, force="mesh", process=False, skip_materials=True)
        return _rows(mesh, "vertices", np.float64), _rows(mesh, "faces", np.int64)
    except (MemoryError, MeshRefusal):
        raise
    except ImportError as error:  # trimesh would call on a package that guesses encodings
        raise MeshRefusal(f"can't be read as {kind.upper()}: must be UTF-8 text or binary") from error
    except Exception as error:  # the readers raise whatever the damage leads them to
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise MeshRefusal(f"can't be read as {kind.upper()}: {reason}") from error


def _check_stl_size(path: Path) -> None:
    """Refuse a binary STL that is cut short: its reader would take it for text and say something misleading."""
    with path.open("rb") as stream:
        head = stream.read(84)
    if head[:5].lower() == b"solid" or len(head) < 84:
        return
    promised, room = int.from_bytes(head[80:], "little"), (path.stat().st_size - 84) / 50
    if promised != room:
        raise MeshRefusal(f"is damaged: its header promises {promised} triangles, its size is that of {room:.10g}")


def _binary_stl(path: Path) -> tuple[Array, Indices] | None:
    """Vertices of each triangle of a binary STL on their own; None for text. trimesh needs three times the memory."""
    with path.open("rb") as stream:
        promised = int.from_bytes(stream.read(84)[80:], "little")
        if not promised or path.stat().st_size != 84 + 50 * promised:
            return None
        records = np.fromfile(stream, STL_TRIANGLE, promised)
    vertices = records["corners"].astype(np.float64).reshape(-1, 3)
    return vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)


def _rows(mesh: object, name: str, dtype: type[Number]) -> NDArray[Number]:
    rows = np.asarray(getattr(mesh, name, ()), dtype=dtype)
    if rows.size and (rows.ndim != 2 or rows.shape[1] != 3):
        raise ValueError(f"its {name} are not rows of three numbers")
    return rows.reshape(-1, 3)


def _check_size(vertices: Array, faces: Indices, unit: str) -> None:
    used = vertices[np.bincount(faces.reshape(-1), minlength=len(vertices)) > 0]
    bad = ~np.isfinite(used).all(axis=1)
    if bad.any():
        raise MeshRefusal(f"has {bad.sum()} vertices with NaN or infinite coordinates: all must be finite")
    extent = float(np.ptp(used, axis=0).max())
    across = f"m across when read in {unit!r}: must be"
    if extent > LARGEST_M:
        raise MeshRefusal(f"is {extent:.3g} {across} at most {LARGEST_M:g} m (millimetres?)")
    if extent < SMALLEST_M:
        raise MeshRefusal(f"is {extent * 1e3:.3g} m{across} at least {SMALLEST_M * 1e3:g} mm (metres?)")
