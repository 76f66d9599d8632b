"""Reading triangle meshes from files of several formats: checked, repaired, or refused in one sentence."""

import codecs
import io
import json
import logging
import math
import re
import warnings
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Literal, TypeVar, cast, get_args

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.image import unit_mm
from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal, turned_outward, welded
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import UNIT_WORDS, UNITS_M, Array
from ctrplan.errors import InputError
from ctrplan.storage.csv_table import HEAD_BYTES, file_name, other_than_named, packed_by

Number = TypeVar("Number", np.float64, np.int64)

Unit = Literal["mm", "cm", "m", "in"]
Up = Literal["y", "z"]
UNITS: tuple[Unit, ...] = get_args(Unit)
SUFFIXES = (".stl", ".ply", ".obj", ".vtk", ".vtp", ".vtu", ".glb")
WITH_GROUPS = (".obj", ".glb")
MAX_BYTES = 500_000_000
HEADER_BYTES = 4096
LARGEST_M, SMALLEST_M = 2.0, 1e-4
ORGAN_M = 5e-3, 1.0  # across, in a unit that explains a size beyond these
VTK = (".vtk", ".vtp", ".vtu")
MARKS: dict[tuple[str, ...], re.Pattern[bytes]] = {  # first bytes of formats, by how the names of their files end
    **{(".ply",): re.compile(rb"ply\s"), (".glb",): re.compile(b"glTF"), VTK: re.compile(b"# vtk DataFile|<VTKFile")},
    **{(".stl",): re.compile(rb"solid\b[^\n]*\n\s*facet"), (".obj",): re.compile(rb"(?:[#\n][^\n]*\n)*v[ \t]+[-+.\d]")},
}
COMMAS = re.compile(rb"(?m)^\s*(?:v|vertex)?(?:\s*[-+]?\d+,\d+\b){3}", re.I)  # three numbers in a row
UNIT = re.compile(r"\b(?:units?\b[\s=:\"']*(?:are|is|in)?|in)[\s=:\"']+([a-z]+)", re.I)  # of a remark


def load_mesh(
    path: str | PathLike[str],
    unit: str | None = None,
    *,
    up: str | None = None,
    file: str | None = None,
    key: str | None = None,
) -> tuple[Array, Indices]:
    """Read a closed mesh: vertices (V, 3) [m] and triangles (F, 3) that wind outward. Several bodies are fine.

    unit: of the file's coordinates, one of UNITS; by default mm, of glTF (.glb) m as its specification has it.
    up: "y" for a file whose y axis points up, which is turned so that z does; by default so for glTF alone. file, key:
    the scenario file and the key in it that named the mesh, for messages.
    Repaired: vertices less than 1 um apart are merged, repeated and collapsed triangles dropped, winding made
    consistent and outward. A shell within another one stays a cavity if the file winds it the other way round.
    Raises InputError, one sentence, for everything else: see the rules in this file.
    """
    name = file_name(path, "a mesh")
    try:
        vertices, faces = welded(*read_triangles(Path(name), unit, up=up))
        return vertices, turned_outward(vertices, faces)
    except MeshRefusal as refusal:
        if file is None and key is None:
            raise InputError(str(refusal), file=name) from refusal.__cause__
        raise InputError(str(refusal), file=file, key=key, value=name) from refusal.__cause__


def read_triangles(
    path: Path, unit: str | None, group: str | None = None, up: str | None = None
) -> tuple[Array, Indices]:
    """Vertices (V, 3) [m] and triangles (F, 3) of a file, or of a group of it, z up. Raises MeshRefusal."""
    vertices, faces = _read(path, group)
    unit = unit or usual_unit(path)
    if unit not in UNITS:
        raise MeshRefusal(f"can't be read in unit {unit!r}: must be one of {', '.join(UNITS)}")
    if up not in (None, "y", "z"):
        raise MeshRefusal(f"can't have {up!r} up: must be y or z")
    vertices = vertices * UNITS_M[unit]
    if (up or usual_up(path)) == "y":
        vertices = np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]])
    _check_size(vertices, faces, unit)
    return vertices, faces


def usual_unit(path: Path) -> Unit:
    """The unit of a file where nobody says another one: metres of glTF, by its specification, else what it states."""
    return "m" if is_gltf(path) else stated_unit(path) or "mm"


def stated_unit(path: Path) -> Unit | None:
    """The unit that a remark near the beginning of a file names; None where none does."""
    try:
        with path.open("rb") as stream:
            head = stream.read(HEADER_BYTES)
    except (OSError, ValueError):  # which whoever reads the mesh says
        return None
    kind, lines = path.suffix.lower(), head.decode("latin-1").splitlines()
    remarks = [line for line in lines if line.startswith(("#", "comment", "obj_info"))]
    remarks = lines[1:2] if kind in VTK else [*(line[:80] for line in lines[:1])] if kind == ".stl" else remarks
    for match in filter(None, map(UNIT.search, remarks)):
        size = unit_mm(match[1].lower())
        for unit in UNITS:
            if size is not None and math.isclose(UNITS_M[unit], size * 1e-3):
                return unit
    return None


def usual_up(path: Path) -> Up:
    """The axis that points up where nobody says another one: y of glTF, by its specification."""
    return "y" if is_gltf(path) else "z"


def is_gltf(path: Path) -> bool:
    """Whether the name is that of binary glTF."""
    return path.suffix.lower() == ".glb"


def axes_notes(path: Path, unit: str | None, up: str | None) -> tuple[str, ...]:
    """What was made of a file's axes and unit by what it states and by its specification, where nobody says them."""
    stated = None if is_gltf(path) else stated_unit(path)
    if stated is not None and unit != stated:
        return (f"says that its unit is {stated}" + (", which is taken" if unit is None else f", is read in {unit}"),)
    defaults = [
        *(["in metres"] if is_gltf(path) and unit is None else []),
        *(["with y up, and was turned so that z is up (key up)"] if is_gltf(path) and up is None else []),
    ]
    return (f"is glTF, by its specification {' and '.join(defaults)}",) if defaults else ()


def stated_frame(path: Path) -> Frame | None:
    """The patient's frame that a file names, as 3D Slicer does near the beginning; None where it does not."""
    with path.open("rb") as stream:
        result = re.search(rb"SPACE\s*=\s*(RAS|LPS)\b", stream.read(HEADER_BYTES))
    return None if result is None else cast(Frame, result[1].decode())


def _read(path: Path, group: str | None) -> tuple[Array, Indices]:
    if path.suffix.lower() not in SUFFIXES:
        raise MeshRefusal(f"is not a mesh: must end in {', '.join(SUFFIXES)}")
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise MeshRefusal("is not a file")
        if size > MAX_BYTES:
            raise MeshRefusal(f"is {size / 1e6:.0f} MB large: must be at most {MAX_BYTES / 1e6:.0f} MB")
        with path.open("rb") as stream:
            head = stream.read(HEADER_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or str(error)
        raise MeshRefusal(f"can't be read: {reason.lower()}") from error
    _check_head(path, head)
    if group is not None and path.suffix.lower() not in WITH_GROUPS:
        raise MeshRefusal(f"has no groups: leave the key group out, {' and '.join(WITH_GROUPS)} may have them")
    vertices, faces = _parsed(path, group)
    if not len(faces):
        raise MeshRefusal("is empty: holds no triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshRefusal(f"is damaged: a triangle refers to a vertex beyond the {len(vertices)} there are")
    return vertices, faces


def _check_head(path: Path, head: bytes) -> None:
    """Raises MeshRefusal for a file that by its first bytes is not what its name says, or has decimal commas."""
    if (packed := packed_by(head)) is not None:
        raise MeshRefusal(f"is packed by {packed}: unpack it first")
    if (other := other_than_named(head[:HEAD_BYTES])) is not None:
        raise MeshRefusal(other)
    kind = next((kind for kind, mark in MARKS.items() if mark.match(head.removeprefix(codecs.BOM_UTF8))), None)
    if kind is not None and path.suffix.lower() not in kind:
        raise MeshRefusal(f"is {kind[0][1:].upper()} by its first bytes: its name must end in {' or '.join(kind)}")
    if b"\0" not in head and COMMAS.search(head):
        rule = "its numbers have decimal commas, must have points"
        raise MeshRefusal(f"can't be read as {path.suffix[1:].upper()}: {rule}")


def _parsed(path: Path, group: str | None) -> tuple[Array, Indices]:
    from ctrplan.anatomy.mesh_formats import (  # where a mesh is read
        read_binary_ply,
        read_binary_stl,
        read_obj,
        read_vtk,
    )

    kind = path.suffix.lower()[1:]
    if kind == "obj":
        return read_obj(path, group)
    if kind in ("vtk", "vtp", "vtu"):
        return read_vtk(path)
    if kind == "ply" and (mesh := read_binary_ply(path.read_bytes())) is not None:
        return mesh
    if kind == "stl" and (mesh := read_binary_stl(path)) is not None:
        return mesh
    try:
        if kind == "glb":
            _check_gltf(path)
        with warnings.catch_warnings(), path.open("rb") as stream:
            warnings.simplefilter("ignore")
            text: BinaryIO = stream
            if kind in ("stl", "ply"):  # of text, with line ends of any kind
                data = stream.read().removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
                _check_rows(data)
                text = io.BytesIO(data)
            return _by_trimesh(text, kind, group)
    except (MemoryError, MeshRefusal):
        raise
    except ImportError as error:  # trimesh would call on a package that guesses encodings
        raise MeshRefusal(f"can't be read as {kind.upper()}: must be UTF-8 text or binary") from error
    except Exception as error:  # its readers raise whatever the damage leads them to
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise MeshRefusal(f"can't be read as {kind.upper()}: {reason}") from error


def _check_rows(text: bytes) -> None:
    """Raises MeshRefusal for text of STL that ends within a triangle, of PLY with other rows than its header states."""
    opened, closed = (len(re.findall(word, text)) for word in (rb"(?im)^\s*facet\b", rb"(?im)^\s*endfacet\b"))
    if opened != closed:
        raise MeshRefusal(f"is damaged or cut short: of {opened} triangles {closed} end")
    header, mark, body = text.partition(b"end_header")
    due = sum(map(int, re.findall(rb"(?m)^element\s+\S+\s+(\d{1,9})\s*$", header)))
    there = sum(bool(row.strip()) for row in body.splitlines())
    if mark and due != there:
        raise MeshRefusal(f"is damaged: its header promises {due} rows, it has {there}")


GLTF_PLAIN = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_")  # extensions that move no vertex


def _check_gltf(path: Path) -> None:
    """Raises MeshRefusal for what a file needs and trimesh passes over, which would leave its vertices elsewhere."""
    with path.open("rb") as stream:
        head = stream.read(20)
        if head[:4] != b"glTF" or int.from_bytes(head[4:8], "little") != 2 or head[16:20] != b"JSON":
            raise MeshRefusal("can't be read as GLB: it is no binary glTF of version 2")
        content = json.loads(stream.read(int.from_bytes(head[12:16], "little")))
        vertices = stream.read()[8:]  # behind the length and the kind of their chunk
    needed = [name for name in content.get("extensionsRequired", ()) if not str(name).startswith(GLTF_PLAIN)]
    if needed:
        raise MeshRefusal(f"needs glTF's extension {needed[0]}: export it without, uncompressed")
    if any("sparse" in accessor for accessor in content.get("accessors", ())):
        raise MeshRefusal("has sparse accessors of glTF: export it without")
    modes = {p.get("mode", 4) for mesh in content.get("meshes", ()) for p in mesh.get("primitives", ())}
    if 6 in modes:
        raise MeshRefusal("has triangle fans of glTF: export it as triangles")
    if any(buffer.get("uri") for buffer in content.get("buffers", ())):
        raise MeshRefusal("has its vertices in another file: export it as one .glb")
    _check_nodes(content)
    for place in {p["attributes"]["POSITION"] for mesh in content.get("meshes", ()) for p in mesh["primitives"]}:
        _check_vertices(content, content["accessors"][place], vertices)


GLTF_MOVING = ("EXT_mesh_gpu_instancing", "EXT_meshopt_compression")  # which a file may use without needing them
GLTF_FLOAT = 5126
SAME = 1e-5  # share of the largest coordinate by which the bounds that glTF states may differ from its vertices


def _check_nodes(content: dict[str, Any]) -> None:
    """Raises MeshRefusal for what moves vertices besides one matrix, or one translation, rotation and scale a node."""
    nodes = content.get("nodes", [])
    for node in nodes:
        if "matrix" in node and (others := {"translation", "rotation", "scale"} & set(node)):
            raise MeshRefusal(f"places a node of glTF twice, by matrix and by {min(others)}: export it with one")
    if any("skin" in node and "mesh" in node for node in nodes):
        raise MeshRefusal("has a skin of glTF, whose joints move its vertices: export it without")
    if any(any(each.get("weights", ())) for each in [*nodes, *content.get("meshes", ())]):
        raise MeshRefusal("has morph targets of glTF that are at work: export it as it shall be, without")
    for each in [*nodes, *content.get("bufferViews", ())]:
        for name in set(GLTF_MOVING) & set(each.get("extensions", ())):
            raise MeshRefusal(f"uses glTF's {name}: export it without")


def _check_vertices(content: dict[str, Any], accessor: dict[str, Any], data: bytes) -> None:
    """Raises MeshRefusal for vertices that are no floats, and for others than the bounds that the file states."""
    if "bufferView" not in accessor:
        raise MeshRefusal("has vertices of glTF without numbers (are they compressed?): export it uncompressed")
    if accessor.get("componentType") != GLTF_FLOAT or accessor.get("normalized"):
        raise MeshRefusal("has vertices of glTF that are no plain floats: export it without quantization")
    view, count = content["bufferViews"][accessor["bufferView"]], accessor["count"]
    start, step = view.get("byteOffset", 0) + accessor.get("byteOffset", 0), view.get("byteStride", 12)
    rows: Array = np.ndarray((count, 3), "<f4", data, start, (step, 4)).astype(np.float64)
    bounds = rows.min(axis=0), rows.max(axis=0)
    for there, name in zip(bounds, ("min", "max"), strict=True):
        stated = accessor.get(name, there)
        if np.abs(there - stated).max() > SAME * np.abs(bounds).max():
            ends = " to ".join(", ".join(f"{x:.4g}" for x in end) for end in bounds)
            size = ", ".join(f"{x:.4g}" for x in stated)
            raise MeshRefusal(f"is damaged: its vertices reach from {ends}, but glTF's {name} states {size}")


def _by_trimesh(stream: BinaryIO, kind: str, group: str | None) -> tuple[Array, Indices]:
    """Text of STL and PLY, and binary glTF: all its meshes where its scene puts them, or those of one name.

    Processing stays off: it would drop NaN vertices silently. Materials are never looked up.
    """
    import trimesh  # takes longer than most meshes

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it logs tracebacks of what is refused in a sentence here
    options = {"file_type": kind, "process": False, "skip_materials": True}
    if kind != "glb":
        mesh = trimesh.load(stream, force="mesh", **options)
        return _rows(mesh, "vertices", np.float64), _rows(mesh, "faces", np.int64)
    scene = trimesh.load_scene(stream, **options)
    vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if group in (None, name, node) and hasattr(mesh, "faces"):
            vertices.append(np.asarray(mesh.vertices) @ transform[:3, :3].T + transform[:3, 3])
            faces.append(np.asarray(mesh.faces, dtype=np.int64) + count)
            count += len(mesh.vertices)
    if group is not None and not count:
        names = sorted(map(str, scene.graph.nodes_geometry))[:12]
        raise MeshRefusal(f"has no group {group!r}, but {', '.join(map(repr, names)) or 'none'}")
    return np.concatenate(vertices), np.concatenate(faces)


def _rows(mesh: object, name: str, dtype: type[Number]) -> NDArray[Number]:
    rows = np.asarray(getattr(mesh, name, ()), dtype=dtype)
    if rows.size and (rows.ndim != 2 or rows.shape[1] != 3):
        raise ValueError(f"its {name} are not rows of three numbers")
    return rows.reshape(-1, 3)


def _check_size(vertices: Array, faces: Indices, unit: Unit) -> None:
    used = vertices[np.bincount(faces.reshape(-1), minlength=len(vertices)) > 0]
    bad = ~np.isfinite(used).all(axis=1)
    if bad.any():
        raise MeshRefusal(f"has {bad.sum()} vertices with NaN or infinite coordinates: all must be finite")
    extent = float(np.ptp(used, axis=0).max())
    across = f"m across when read in {unit!r}: must be"
    read = extent / UNITS_M[unit]
    usual = [UNIT_WORDS[other] for other in UNITS if ORGAN_M[0] <= read * UNITS_M[other] <= ORGAN_M[1]]
    hint = f"({' or '.join(usual)}?)" if usual else "(converted twice?)"
    if extent > LARGEST_M:
        raise MeshRefusal(f"is {extent:.3g} {across} at most {LARGEST_M:g} m {hint}")
    if extent < SMALLEST_M:
        raise MeshRefusal(f"is {extent * 1e3:.3g} m{across} at least {SMALLEST_M * 1e3:g} mm {hint}")
