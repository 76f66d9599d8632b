"""What the files of a case hold: structures that may be lumens or obstacles, and points."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ctrplan.anatomy.images.image import ImageRefusal, UnfitImageRefusal
from ctrplan.anatomy.images.image_file import is_image
from ctrplan.anatomy.mesh_file import SUFFIXES as MESHES
from ctrplan.cases.moving import later_phases
from ctrplan.cases.structures import Structure, of_image, of_mesh
from ctrplan.errors import InputError
from ctrplan.files.slicer.markups_file import is_markups, read_markups

if TYPE_CHECKING:
    from ctrplan.files.slicer.markups_file import Markup

MOST_FILES = 200


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


def found_in(
    inputs: Sequence[str],
    unit: str,
    output: Path,
    series: str | None = None,
    phases: Sequence[Sequence[str]] = (),
) -> Found:
    """What files and folders hold; what a case has written into `output` is none of it. Raises InputError.

    phases: files among them of one structure each, in several phases: what the first holds is found, the others go with
    it. Images in a folder that are too large, or of a kind that is not read, are left out with a note.
    """
    structures, markups, grey, notes = list[Structure](), list["Markup"](), list[Path](), list[str]()
    later, named = later_phases(phases), [Path(name) for name in inputs]
    others = {file.resolve() for files in later.values() for file in files}
    for path in dict.fromkeys(_files(inputs, output)):
        if path.resolve() in others:
            continue
        if is_markups(path):
            markups += read_markups(path)
        elif path.suffix.lower() in MESHES:
            structures.append(of_mesh(path, unit))
        elif path.is_dir():
            grey.append(path)
        else:
            within, why_not = _of_image(path, is_named=path in named)
            structures += within
            grey += [] if within else [path]
            notes += [why_not] if why_not else []
    moving = [replace(one, phases=later.get(one.file.resolve(), ())) for one in structures]
    return Found(tuple(moving), tuple(markups), tuple(grey), tuple(notes), series)


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


def _of_image(path: Path, *, is_named: bool) -> tuple[list[Structure], str]:
    """Its structures; and why it was not looked at, if that is so. Raises InputError for one that is damaged."""
    try:
        return of_image(path), ""
    except ImageRefusal as refusal:
        if isinstance(refusal, UnfitImageRefusal) and not is_named:
            return [], f"{path.name} is left out, since it {refusal}"
        raise InputError(str(refusal), file=path) from refusal.__cause__
