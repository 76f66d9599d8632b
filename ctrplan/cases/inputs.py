"""What the files of a case hold: structures that may be lumens or obstacles, and points."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.anatomy.images.image import Image, ImageRefusal
from ctrplan.anatomy.images.image_file import is_image, read_image
from ctrplan.anatomy.mesh_file import SUFFIXES as MESHES
from ctrplan.errors import InputError
from ctrplan.files.slicer.markups_file import is_markups, read_markups

if TYPE_CHECKING:
    from ctrplan.files.slicer.markups_file import Markup

MOST_FILES = 200
MOST_LABELS = 256  # of a label map; what has more values holds grey ones
PACKED = re.compile(r"\.(seg\.nrrd|nii\.gz|mrk\.json)$|\.[^.]+$", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Structure:
    """Something that a file holds: its name, how large it is, and the keys of the [[anatomy]] that takes it."""

    file: Path
    name: str
    size: str
    entry: dict[str, Any] = field(default_factory=dict)

    @property
    def called(self) -> str:
        """As messages list it."""
        return f"{self.name} ({self.size} in {self.file.name})"


@dataclass(frozen=True)
class Found:
    """All that the inputs hold. grey: images of grey values, of which nothing is a structure by itself."""

    structures: tuple[Structure, ...]
    markups: tuple[Markup, ...]
    grey: tuple[Path, ...]
    notes: tuple[str, ...] = ()
    series: str | None = None  # that is meant of a DICOM folder

    @property
    def listed(self) -> str:
        """The structures in a sentence."""
        return ", ".join(one.called for one in self.structures) or "no structures"


def found_in(inputs: Sequence[str], unit: str, output: Path, series: str | None = None) -> Found:
    """What files and folders hold; what a case has written into `output` is none of it. Raises InputError."""
    structures, markups, grey, notes = list[Structure](), list["Markup"](), list[Path](), list[str]()
    for path in _files(inputs, output):
        if is_markups(path):
            markups += read_markups(path)
        elif path.suffix.lower() in MESHES:
            structures.append(_mesh(path, unit))
        elif path.is_dir():
            grey.append(path)
        else:
            of_image, why_not = _of_image(path)
            structures += of_image
            grey += [] if of_image else [path]
            notes += [why_not] if why_not else []
    return Found(tuple(structures), tuple(markups), tuple(grey), tuple(notes), series)


def stem(path: Path) -> str:
    """The name without its ending, also of a double one."""
    return PACKED.sub("", path.name) or path.name


def _files(inputs: Sequence[str], output: Path) -> Iterator[Path]:
    for name in inputs:
        path = Path(name)
        try:
            there = path.exists()
        except (OSError, ValueError):
            there = False
        if not there:
            raise InputError("does not exist", file=name)
        if path.is_dir():
            yield from _in_folder(path, output)
        elif _is_known(path):
            yield path
        elif path.suffix.lower() == ".dcm":
            yield path.parent
        else:
            rule = "is no image, mesh or file of markups: must end in .nii, .nii.gz, .nrrd, .mha, .mhd, "
            raise InputError(f"{rule}{', '.join(MESHES)}, .mrk.json or .fcsv", file=name)


def _in_folder(folder: Path, output: Path) -> Iterator[Path]:
    own = output.resolve()
    known, others = list[Path](), False
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(
            name for name in folders if not name.startswith(".") and (Path(place) / name).resolve() != own
        )
        for name in sorted(name for name in names if not name.startswith(".")):
            others = others or Path(place) == folder
            known += [Path(place) / name] if _is_known(Path(name)) else []
        if len(known) > MOST_FILES:
            raise InputError(f"holds more than {MOST_FILES} images, meshes and files of markups", file=folder)
    if not known and not others:
        raise InputError("holds no files", file=folder)
    yield from known or [folder]


def _is_known(path: Path) -> bool:
    return is_image(path) or is_markups(path) or path.suffix.lower() in MESHES


def _mesh(path: Path, unit: str) -> Structure:
    return Structure(path, stem(path), "mesh", {"kind": "mesh", "unit": unit})


def _of_image(path: Path) -> tuple[list[Structure], str]:
    """Its labels or segments, none of an image of grey values; and why it was not looked at, if that is so."""
    try:
        image = read_image(path)
    except ImageRefusal as refusal:
        raise InputError(str(refusal), file=path) from refusal.__cause__
    if image.segments:
        return [_segment(path, image, one.name, one.label, one.layer) for one in image.segments], ""
    counts = _labels(image)
    name = stem(path)
    size = {label: f"{count * image.voxel_mm3 / 1e3:.3g} ml" for label, count in counts.items()}
    if len(counts) == 1:
        return [Structure(path, name, text, _label(label)) for label, text in size.items()], ""
    return [Structure(path, str(label), text, _label(label)) for label, text in size.items()], ""


def _label(label: int) -> dict[str, Any]:
    return {"kind": "volume", "label": label}


def _segment(path: Path, image: Image, name: str, label: int, layer: int) -> Structure:
    voxels = image.voxels if image.voxels.ndim == 3 else image.voxels[..., layer]
    size = np.count_nonzero(voxels == label) * image.voxel_mm3 / 1e3
    return Structure(path, name, f"{size:.3g} ml", {"kind": "volume", "segment": name})


def _labels(image: Image) -> dict[int, int]:
    """Voxels by label; none where values are those of a grey image."""
    voxels = image.voxels
    if voxels.ndim != 3 or voxels.min() < 0 or voxels.max() < 1 or voxels.max() > np.iinfo(np.int32).max:
        return {}
    if voxels.dtype.kind == "f" and np.any(voxels != np.round(voxels)):
        return {}
    if voxels.max() < 1 << 16:
        counts = np.zeros(1 << 16, np.int64)
        for plane in voxels:
            counts += np.bincount(plane.astype(np.uint16).reshape(-1), minlength=1 << 16)
        values = np.flatnonzero(counts)
        numbers = counts[values]
    else:
        values, numbers = np.unique(voxels, return_counts=True)
    found = {int(value): int(number) for value, number in zip(values, numbers, strict=True) if value != 0}
    return found if len(found) <= MOST_LABELS else {}
