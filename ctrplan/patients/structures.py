"""Structures that the files of a case contain, which of them move, and which are lumens or obstacles."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.anatomy import image_file
from ctrplan.anatomy.image import Image, ImageRefusal, UnfitImageRefusal
from ctrplan.anatomy.image_file import is_image
from ctrplan.anatomy.mesh_file import SUFFIXES as MESHES
from ctrplan.anatomy.mesh_file import usual_unit
from ctrplan.anatomy.parts import AnatomyPart, Phases
from ctrplan.anatomy.shape import Role
from ctrplan.anatomy.structure import image_of, volume_of
from ctrplan.base.arrays import MM_PER_M
from ctrplan.errors import InputError
from ctrplan.files.slicer_markups import is_markups, read_markups

if TYPE_CHECKING:
    from ctrplan.files.slicer_markups import PlacedMarkup

MOST_LABELS = 256  # of a label map; what has more values holds grey ones
PACKED = re.compile(r"\.(seg\.nrrd|nii\.gz|mrk\.json)$|\.[^.]+$", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Structure:
    """Something that a file holds: its name, how large it is, and the keys of the [[anatomy]] that takes it."""

    file: Path
    name: str
    size: str
    entry: dict[str, Any] = field(default_factory=dict)
    phases: tuple[Path, ...] = ()  # files of further phases of one that moves

    @property
    def called(self) -> str:
        """The structure as messages list it."""
        return f"{self.name} ({self.size} in {self.file.name})"


def stem(path: Path) -> str:
    """The name without its ending, also of a double one."""
    return PACKED.sub("", path.name) or path.name


def of_mesh(path: Path, unit: str | None) -> Structure:
    """The body of a mesh, which is not read yet; where nobody says a unit, it is that of its format."""
    return Structure(path, stem(path), "mesh", {"kind": "mesh", "unit": unit or usual_unit(path)})


def of_image(path: Path) -> list[Structure]:
    """Labels or segments; none of an image of grey values. Raises ImageRefusal."""
    image = image_of(path, image_file.read_image)
    if image.segments:
        sizes = [(s.name, volume_of(image, s.label, s.layer)) for s in image.segments]
        return [Structure(path, name, size, {"kind": "volume", "segment": name}) for name, size in sizes]
    counts = _labels(image)
    name = stem(path)
    size = {label: f"{count * image.voxel_mm3 / 1e3:.3g} ml" for label, count in counts.items()}
    return [
        Structure(path, name if len(counts) == 1 else str(label), text, {"kind": "volume", "label": label})
        for label, text in size.items()
    ]


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
    results = {int(value): int(number) for value, number in zip(values, numbers, strict=True) if value != 0}
    return results if len(results) <= MOST_LABELS else {}


STEP_MM = 0.1  # to which a margin is rounded up


def later_phases(phases: Sequence[Sequence[str]]) -> dict[Path, tuple[Path, ...]]:
    """Files of further phases by that of the first, which may be said again as the last of three phases or more.

    Raises InputError for a single one, a folder, one said twice.
    """
    said = [[Path(name).resolve() for name in group] for group in phases]
    files = [file for group in said for file in (group[:-1] if len(group) > 3 and group[0] == group[-1] else group)]
    for group in phases:
        if len(group) < 2:
            raise InputError("must be two files at least, one of each phase", key="--phases", value=" ".join(group))
    if folders := [file for file in files if file.is_dir()]:
        raise InputError("is a folder: name the files of the phases", key="--phases", value=folders[0].name)
    if twice := [file for file in files if files.count(file) > 1]:
        raise InputError("is said twice", key="--phases", value=twice[0].name)
    return {Path(group[0]).resolve(): tuple(map(Path, group[1:])) for group in phases}


def between_phases_mm(part: AnatomyPart) -> float | None:
    """Half the way from one phase to the next, rounded up: the farthest that a straight way leads from both.

    None for a structure that does not move.
    """
    if not isinstance(part.shape, Phases):
        return None
    return round(math.ceil(part.shape.apart_m() / 2 * MM_PER_M / STEP_MM) * STEP_MM, 6)


def with_margin(part: AnatomyPart, motion_margin_mm: float) -> AnatomyPart:
    """The part with that margin for places between its phases."""
    assert isinstance(part.shape, Phases), "between_phases_mm has a number of such parts alone"
    shape = replace(part.shape, motion_margin_m=motion_margin_mm / MM_PER_M)
    more_m = shape.surface_error_m - part.shape.surface_error_m
    return AnatomyPart(shape, part.role, part.margin_m + more_m)


MOST_FILES = 200


@dataclass(frozen=True)
class CaseContent:
    """All that the inputs hold. grey: images of grey values, of which nothing is a structure by itself."""

    structures: tuple[Structure, ...]
    markups: tuple[PlacedMarkup, ...]
    grey: tuple[Path, ...]
    notes: tuple[str, ...] = ()
    series: str | None = None  # that is meant of a DICOM folder

    @property
    def listed(self) -> str:
        """The structures in a sentence."""
        return ", ".join(structure.called for structure in self.structures) or "no structures"


def content_of(
    inputs: Sequence[str],
    unit: str | None,
    output: Path,
    series: str | None = None,
    phases: Sequence[Sequence[str]] = (),
) -> CaseContent:
    """What files and folders hold; what a case has written into `output` is none of it. Raises InputError.

    phases: files among them of one structure each, in several phases: what the first holds is found, the others go with
    it. Images in a folder that are too large, or of a kind that is not read, are left out with a note.
    """
    structures, markups, grey, notes = list[Structure](), list["PlacedMarkup"](), list[Path](), list[str]()
    later, named = later_phases(phases), [Path(name) for name in inputs]
    others = {file.resolve() for files in later.values() for file in files} - set(later)
    for path in dict.fromkeys(case_files(inputs, output)):
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
    moving = [replace(structure, phases=later.get(structure.file.resolve(), ())) for structure in structures]
    return CaseContent(tuple(moving), tuple(markups), tuple(grey), tuple(notes), series)


def case_files(inputs: Sequence[str], output: Path) -> Iterator[Path]:
    """Images, meshes and markups that the inputs name or hold, and folders of others. Raises InputError."""
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
    """Structures of an image, and why it was not looked at, if so. Raises InputError for a damaged one."""
    try:
        return of_image(path), ""
    except ImageRefusal as refusal:
        if isinstance(refusal, UnfitImageRefusal) and not is_named:
            return [], f"{path.name} is left out, since it {refusal}"
        raise InputError(str(refusal), file=path) from refusal.__cause__


LUMEN = re.compile(r"airway|trachea|bronch|lumen|ventric|cavity|phary|laryn", re.IGNORECASE)
AVOID = re.compile(
    r"vessel|arter|vein|venous|aort|carotid|vascula|bone|skull|rib(s|_|\b|cage)|vertebr|spine|nerve|obstacle|avoid",
    re.IGNORECASE,
)
RANGE = re.compile(r"\s*(above|below)\s*=\s*(-?\d+(\.\d+)?)\s*(,|$)")


def chosen(
    content: CaseContent,
    lumens: Sequence[str],
    avoids: Sequence[str],
    ignored: Sequence[str],
    targets: Sequence[Structure] = (),
) -> tuple[list[tuple[Structure, Role]], list[str]]:
    """Structures with their roles, and a note of those that were recognised or left out. Raises InputError.

    Names are of segments, labels, meshes or files; "FILE:NAME" where two files have one, "FILE:above=200" of grey
    values. targets: structures to be reached, which are not avoided.
    """
    roles: dict[Structure, Role | None] = {}
    stated: list[tuple[str, Sequence[str], Role | None]] = [
        ("--lumen", lumens, "inside"),
        ("--avoid", avoids, "avoid"),
        ("--ignore", ignored, None),
    ]
    for option, names, role in stated:
        for name in names:
            structure = named(content, option, name)
            if roles.setdefault(structure, role) != role:
                raise InputError("is said to be two things", key=option, value=name)
    for structure in targets:
        if roles.setdefault(structure, None) == "avoid":
            raise InputError("is said to be two things", key="--target", value=structure.name)
    recognised = {
        structure: role
        for structure in content.structures
        if structure not in roles and (role := by_name(structure.name))
    }
    roles |= recognised
    taken = [(structure, role) for structure, role in roles.items() if role]
    left = [structure for structure in content.structures if structure not in roles]
    if not taken:
        rule = "is needed, or --avoid: which structure the robot moves through and which it avoids can't be known of"
        raise InputError(f"{rule} {content.listed}{_grey(content)}", key="--lumen")
    return taken, [*_recognised(recognised), *_left(left)]


def by_name(name: str) -> Role | None:
    """The role that a name tells; None where it tells none, or two."""
    is_lumen, is_obstacle = bool(LUMEN.search(name)), bool(AVOID.search(name))
    if is_lumen == is_obstacle:
        return None
    return "inside" if is_lumen else "avoid"


def named(content: CaseContent, option: str, text: str) -> Structure:
    """The structure that an option names. Raises InputError with those that there are."""
    structure = matching(content, option, text)
    if structure is None:
        rule = f"is not there: the files hold {content.listed}{_grey(content)}"
        raise InputError(rule, key=option, value=text)
    return structure


def matching(content: CaseContent, option: str, text: str) -> Structure | None:
    """The structure that a text names; None where none is called so. Raises InputError for several."""
    matches = [structure for structure in content.structures if text in (structure.name, structure.file.name)]
    matches = matches or [structure for structure in content.structures if text.lower() == structure.name.lower()]
    file, colon, name = text.partition(":")
    if not matches and colon:
        grey = (path for path in content.grey if file == stem(path) or _is_named(path, file))
        if (image := next(grey, None)) is not None:
            return _range(content, image, option, text, name)
        within = [structure for structure in content.structures if _is_named(structure.file, file)]
        # A label map of one label is called by its file, its label is still a name.
        matches = [s for s in within if name in (s.name, str(s.entry.get("label")))]
        if not matches and within and within[0].entry["kind"] == "mesh":
            return Structure(within[0].file, name, "group", {**within[0].entry, "group": name})
    if len({structure.file for structure in matches}) > 1:
        where = ", ".join(structure.called for structure in matches)
        rule = f"is in several files, say which as FILE:{matches[0].name}: {where}"
        raise InputError(rule, key=option, value=text)
    if len(matches) > 1:
        rule = f"names several structures: the files hold {content.listed}{_grey(content)}"
        raise InputError(rule, key=option, value=text)
    return matches[0] if matches else None


def _is_named(path: Path, file: str) -> bool:
    return file == path.name or os.path.normpath(file) == os.path.normpath(path)


def _range(content: CaseContent, image: Path, option: str, text: str, ranges: str) -> Structure:
    ends: dict[str, Any] = {}
    place = 0
    while match := RANGE.match(ranges, place):
        ends[match[1]] = float(match[2])
        place = match.end()
    if not ends or place < len(ranges):
        rule = (
            f"{image.name} has grey values: say a range as {image.name}:below=-500 or {image.name}:above=100,below=300"
        )
        raise InputError(rule, key=option, value=text)
    series = {"series": content.series} if image.is_dir() and content.series else {}
    return Structure(image, ranges, "grey values", {"kind": "volume", **series, **ends})


def _grey(content: CaseContent) -> str:
    if not content.grey:
        return ""
    name = content.grey[0].name
    return f"; {name} has grey values, of which a range can be said as {name}:below=-500"


def _recognised(roles: dict[Structure, Any]) -> list[str]:
    words = {"inside": "a lumen, to stay inside", "avoid": "an obstacle, to be avoided"}
    return [
        f"{structure.called} is taken for {words[role]}: by its name (--ignore '{structure.name}' leaves it out)"
        for structure, role in roles.items()
    ]


def _left(structures: Sequence[Structure]) -> list[str]:
    if not structures:
        return []
    return [f"left out, since nobody says what they are: {', '.join(structure.called for structure in structures)}"]
