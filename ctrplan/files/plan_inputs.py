"""inputs.zip of a plan's folder: the scenario, its robot and the files it names, by content; and a folder as one file.

With it a plan opens from anywhere. The scenario keeps its own content: files in its folder or below keep their places,
others get one, and the manifest says which name stood there, so that the hash of what was planned can be taken again.
"""

from __future__ import annotations

import copy
import hashlib
import io
import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ctrplan.anatomy.fixture import Fixture
from ctrplan.anatomy.image import data_files
from ctrplan.anatomy.image_file import MOST_BYTES
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shape import PartShape
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.surface import Sheet
from ctrplan.anatomy.surface_file import HUGE
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.output_folder import CHECKSUMS, stated_sums, write_atomically
from ctrplan.storage.toml_document import toml_text

INPUTS, MANIFEST, SCENARIO = "inputs.zip", "manifest.json", "scenario.toml"
SUFFIX = ".ctrplan"  # of a plan's folder as one file
MOST_PACKED = 300_000_000  # of all that is packed: a plan in larger images opens where they are
_OPENED: dict[tempfile.TemporaryDirectory[str], Path] = {}  # what was unpacked into folders that end with this process


def inputs_of(scenario: Scenario) -> bytes | None:
    """The content of inputs.zip, in which meshes made of arrays become files; None where that can't hold the scenario.

    One that would be too large opens where its files are; one with other bodies of arrays, by the scenario itself.
    """
    content: dict[str, Any] = copy.deepcopy(dict(scenario.content))
    if not content:
        return None
    folder = Path(scenario.path or ".").parent
    packed, names = dict[str, bytes](), dict[str, str]()
    if isinstance(content["robot"], str):  # else it stands in the scenario itself
        robot = _place(content["robot"], folder, names)
        packed[robot] = toml_text(scenario.robot.content).encode()
        content["robot"] = robot
    tables = [*content.get("anatomy", []), *content.get("fixture", [])]
    bodies: list[AnatomyPart | Fixture] = [*scenario.anatomy, *scenario.fixtures]
    for k, table in enumerate(tables):
        if len(bodies) == len(tables) and bodies[k].source_table is None:  # made in code
            if (written := _written(bodies[k].shape, f"bodies/{k + 1}.ply", table)) is None:
                return None
            packed |= written
            continue
        for key in ("file", "files"):
            if key not in table:
                continue
            listed = table[key] if isinstance(table[key], list) else [table[key]]
            places = [_place(str(name), folder, names) for name in listed]
            for name, place in zip(listed, places, strict=True):
                packed |= _packed(folder / str(name), place)
            table[key] = places if isinstance(table[key], list) else places[0]
    if sum(map(len, packed.values())) > MOST_PACKED:
        return None
    packed[SCENARIO] = toml_text(content).encode()
    manifest = {"scenario_sha256": scenario.sha256, "robot_sha256": scenario.robot.sha256, "named": names}
    packed[MANIFEST] = json.dumps(manifest, indent=1, ensure_ascii=False).encode()
    return _zipped(packed)


def _written(shape: PartShape, place: str, table: dict[str, Any]) -> dict[str, bytes] | None:
    """The file of a body whose arrays no table says; the table names it then. Nothing for what keys say.

    None of what is no mesh, or would be thinned when it is read.
    """
    with suppress(InputError):
        shape.keys()
        return {}
    if type(shape) not in (Mesh, Sheet) or shape.surface_error_m or len(shape.surface().faces) > HUGE:
        return None
    table |= {"file": place, "unit": "m"} | ({"repair": "off"} if shape.kind == Mesh.kind else {})
    vertices, faces = shape.surface().vertices_m, shape.surface().faces
    corners = "".join(f"property double {axis}\n" for axis in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{corners}"
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return {place: header.encode() + vertices.astype("<f8").tobytes() + rows.tobytes()}


def _place(name: str, folder: Path, names: dict[str, str]) -> str:
    """Where a file is in the archive: in its own place where that lies in the scenario's folder or below."""
    try:
        inside = not Path(name).is_absolute() and (folder / name).resolve().is_relative_to(folder.resolve())
    except OSError:
        inside = False
    if inside and PurePosixPath(name).as_posix() == name and ".." not in PurePosixPath(name).parts:
        return name
    place = f"elsewhere/{len(names) + 1}/{Path(name).name}"
    names[place] = name
    return place


def _packed(path: Path, place: str) -> dict[str, bytes]:
    """The bytes of a file, or of the files of a folder, such as a DICOM series; with the data file of a header."""
    if path.is_dir():
        return {f"{place}/{part.name}": part.read_bytes() for part in sorted(path.iterdir()) if part.is_file()}
    beside = data_files(path)
    others = {
        (PurePosixPath(place).parent / part.relative_to(path.parent).as_posix()).as_posix(): part.read_bytes()
        for part in beside
    }
    return {place: path.read_bytes(), **others}


def _zipped(packed: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in packed.items():
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def scenario_within(folder: Path, overrides: Sequence[str] = ()) -> Scenario | None:
    """The scenario that a plan's folder holds, with `overrides`; None where it holds none. Raises InputError.

    Whether it is the plan's, the hashes in plan.json say.
    """
    if not (folder / INPUTS).is_file():
        return None
    place = unpacked(folder / INPUTS)
    if not (place / MANIFEST).is_file():
        raise InputError("is damaged: it has no manifest", file=str(folder / INPUTS))
    return load_scenario(place / SCENARIO, overrides)


def unpacked(path: Path) -> Path:
    """A folder with the content of an archive, there until this process ends. Raises InputError."""
    folder = tempfile.TemporaryDirectory(prefix="ctrplan-")
    _OPENED[folder] = path
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > MOST_BYTES:
                raise InputError(f"unpacks to more than {MOST_BYTES / 1e9:g} GB", file=str(path))
            for member in members:
                if PurePosixPath(member.filename).is_absolute() or ".." in PurePosixPath(member.filename).parts:
                    raise InputError(f"holds {member.filename}, which leads out of it", file=str(path))
            archive.extractall(folder.name)
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise InputError(f"is damaged ({' '.join(str(error).split())})", file=str(path)) from None
    except RuntimeError as error:  # of zipfile: a password, or a way of packing that it does not know
        raise InputError(f"can't be unpacked ({' '.join(str(error).split())})", file=str(path)) from None
    except OSError as error:
        raise InputError(f"can't be read or unpacked ({error.strerror or error})", file=str(path)) from None
    return Path(folder.name)


@contextmanager
def plan_json_of(path: str) -> Iterator[str]:
    """The plan.json that a path stands for: itself, within a folder, or within a plan's folder as one file.

    Raises InputError where there is none. Faults within the block are told by names of files as they were given.
    """
    packed = path.lower().endswith(SUFFIX)
    file = (unpacked(Path(path)) if packed else Path(path)) / "plan.json"
    if not packed and not Path(path).is_dir():
        file = Path(path)
    elif not file.is_file():
        raise InputError("holds no plan.json: is it what ctrplan plan wrote?", file=path)
    try:
        yield str(file)
    except InputError as error:
        if (named := _as_given(error.file)) == error.file:
            raise
        raise InputError(error.rule, file=named, key=error.key, value=error.value, unit=error.unit) from None


CHANGED = {
    "plan.json": "its figures may not be those that were computed; verifying it computes them anew",
    "trajectory.csv": "the certificate is of the motion that was in it; ctrplan verify judges the one that is",
    "trajectory.yaml": "it may drive another motion than trajectory.csv; ctrplan plan writes it again",
    INPUTS: "scenario and robot have the plan's hashes all the same",
}
SHOWN = "it may show another plan than plan.json; ctrplan plan writes it again"


def changed_files(folder: Path) -> dict[str, InputError]:
    """Files of a plan's folder, by name, that are not those that were written together, and what that means.

    Any of them may be edited: nothing that plan.json says is believed by `ctrplan verify`. Only where the figures are
    taken as they stand, by `open_plan`, is this a reason to refuse. Without sums, as of plans of others, none is known.
    """
    changed = {}
    for name, stated in stated_sums(folder).items():
        path = folder / name
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() == stated:
            continue
        rule = f"was changed after it was written, by {CHECKSUMS}: {CHANGED.get(name, SHOWN)}"
        changed[name] = InputError(rule, file=_as_given(path))
    return changed


def _as_given(file: str | os.PathLike[str] | None) -> str | os.PathLike[str] | None:
    """The name of a file in a folder that was unpacked, by that of the archive, which may be in another one."""
    for folder, archive in reversed(_OPENED.items()):
        if file is not None and Path(file).is_relative_to(folder.name):
            file = str(archive / Path(file).relative_to(folder.name))
    return file


def write_as_one(folder: Path, path: Path) -> None:
    """Writes the files of a plan's folder as one file, whole or not at all. Raises CtrplanError."""
    files = {part.name: part.read_bytes() for part in sorted(folder.iterdir()) if part.is_file()}
    write_atomically(path, _zipped(files))
