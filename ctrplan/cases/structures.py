"""Structures that a file holds: the body of a mesh, segments or labels of an image, with their sizes."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.anatomy.images.image import Image
from ctrplan.anatomy.images.kept import image_of

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
        """As messages list it."""
        return f"{self.name} ({self.size} in {self.file.name})"


def stem(path: Path) -> str:
    """The name without its ending, also of a double one."""
    return PACKED.sub("", path.name) or path.name


def of_mesh(path: Path, unit: str) -> Structure:
    """The body of a mesh, which is not read yet."""
    return Structure(path, stem(path), "mesh", {"kind": "mesh", "unit": unit})


def of_image(path: Path) -> list[Structure]:
    """Labels or segments; none of an image of grey values. Raises ImageRefusal."""
    image = image_of(path)
    if image.segments:
        return [_segment(path, image, one.name, one.label, one.layer) for one in image.segments]
    counts = _labels(image)
    name = stem(path)
    size = {label: f"{count * image.voxel_mm3 / 1e3:.3g} ml" for label, count in counts.items()}
    if len(counts) == 1:
        return [Structure(path, name, text, _label(label)) for label, text in size.items()]
    return [Structure(path, str(label), text, _label(label)) for label, text in size.items()]


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
