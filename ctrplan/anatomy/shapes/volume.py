"""A structure of a medical image: a label, a named segment, or grey values of a range."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from ctrplan.anatomy.image import Image, ImageRefusal
from ctrplan.anatomy.patient_frame import Frame, to_scenario
from ctrplan.anatomy.shape import PartEntry, register
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.structure import ImageStructure, StructureChoice, has_thin_parts, image_of, structure
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.package import shown
from ctrplan.storage.toml_document import Component, Distance, TomlTable

Label = Annotated[int, Meta(ge=1, le=2**31 - 1)]


@shown
@dataclass(frozen=True, eq=False)
class Volume(Mesh):
    """The surface of a structure between the voxels of an image, in the anatomy's frame.

    image_box_m (8, 3): corners of the image. notes: what to know. surface_error_m: what the surface may be off by.
    segment: its name in the file, where it has one.
    """

    kind = "volume"
    image_box_m: Array | None = None
    segment: str | None = None

    @property
    def name(self) -> str:
        """What messages call it: several segments are in one file."""
        return self.segment or super().name


@register(Volume)
class VolumeEntry(PartEntry):
    """kind = "volume"."""

    file: str
    series: str | None = None
    label: Label | None = None
    segment: str | None = None
    above: Component | None = None
    below: Component | None = None
    frame: Frame | None = None
    surface_error_mm: Distance | None = None

    def shape(self, table: TomlTable) -> Volume:
        choice = self._choice(table)
        path = table.place(self.file, "file")
        try:
            image = _read(path, self.series)
            signs = to_scenario(table, image.frame, self.frame, is_patient=True)
            image = replace(image, origin_m=signs * image.origin_m, direction=signs[:, None] * image.direction)
            return volume(image, choice, str(path), self.surface_error_mm)
        except ImageRefusal as refusal:
            key = _blamed(choice, str(refusal))
            name = "" if key == "file" else f"{path.name} "
            raise table.fault(f"{name}{refusal}", key) from refusal.__cause__

    def _choice(self, table: TomlTable) -> StructureChoice:
        choice = StructureChoice(self.label, self.segment, self.above, self.below)
        if sum((choice.label is not None, choice.segment is not None, choice.is_range)) > 1:
            raise table.fault("must be one of label, segment, and above or below", "file")
        if None not in (self.above, self.below) and not self.above < self.below:  # type: ignore[operator]
            raise table.fault("must be less than below", "above")
        return choice


def volume(image: Image, choice: StructureChoice, file: str, surface_error_mm: float | None = None) -> Volume:
    """The surface of what is chosen of an image. Raises ImageRefusal where that is nothing."""
    from ctrplan.anatomy.structure import level_surface  # slow to import
    from ctrplan.anatomy.surface_file import thinned, thinning_note

    result = structure(image, choice)
    vertices, faces = level_surface(result)
    if np.linalg.det(image.direction) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    error = _voxels_off(result) * float(image.spacing_m.max())
    if surface_error_mm is not None:
        error = surface_error_mm / MM_PER_M
    places, faces, moved = thinned(image.place_m(vertices + result.first), faces)
    notes = (*image.notes, *_notes(result, error), *thinning_note(faces, moved))
    return Volume(places, faces, file, notes, error + moved, _box(image), choice.segment)


def _voxels_off(result: ImageStructure) -> float:
    """What a surface may be off by in widest voxels."""
    from ctrplan.anatomy.structure import GREY_ERROR, LABEL_ERROR, THIN_ERROR

    if result.above is not None:
        return GREY_ERROR
    return THIN_ERROR if has_thin_parts(result.inside) else LABEL_ERROR


def _read(path: Path, series: str | None) -> Image:
    from ctrplan.anatomy.dicom import read_series  # with SimpleITK, which few scenarios need
    from ctrplan.anatomy.image_file import SUFFIXES, is_image, read_image

    if path.is_dir() or path.suffix.lower() == ".dcm":
        return read_series(path if path.is_dir() else path.parent, series)
    if not is_image(path):
        raise ImageRefusal(f"is no volume: must end in {', '.join(SUFFIXES)}, or be a folder of a DICOM series")
    if series is not None:
        raise ImageRefusal("has no series: leave the key series out")
    return image_of(path, read_image)


def _box(image: Image) -> Array:
    """Corners (8, 3) of the outermost voxels' far sides."""
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return image.place_m(corner * np.array(image.size) - 0.5)


def _notes(result: ImageStructure, error_m: float) -> tuple[str, ...]:
    off = f"its surface may be off by {error_m * MM_PER_M:.3g} mm, which the margin includes" if error_m else ""
    edge = "reaches the edge of the image and is closed there: beyond it nothing is known" if result.at_edge else ""
    return tuple(note for note in (edge, off) if note)


def _blamed(choice: StructureChoice, rule: str) -> str:
    """The key that a sentence is about."""
    if "of that label" in rule:
        return "label"
    if "segment" in rule and choice.segment is not None:
        return "segment"
    return "series" if "of that series UID" in rule else "file"
