"""Names of structures in a segmentation, as 3D Slicer writes them into .seg.nrrd, and labels that a volume holds."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from ctrplan.anatomy.images.image import Image, Segment

SHOWN = 12


def segments_of(metadata: Mapping[str, str]) -> tuple[Segment, ...]:
    """The segments that the keys of a file name, in their order there; none for any other file."""
    numbers = sorted(int(match[1]) for key in metadata if (match := re.fullmatch(r"Segment(\d+)_LabelValue", key)))
    return tuple(
        Segment(
            metadata.get(f"Segment{k}_Name", metadata.get(f"Segment{k}_ID", str(k))),
            int(metadata[f"Segment{k}_LabelValue"]),
            int(metadata.get(f"Segment{k}_Layer", "0")),
        )
        for k in numbers
    )


def listed(image: Image) -> str:
    """What there is to choose from: names, labels and their volumes."""
    if image.segments:
        return _joined([f"{s.name!r} ({_volume(image, s.label, s.layer)})" for s in image.segments])
    values, counts = np.unique(image.voxels, return_counts=True)
    found = [
        f"{value:g} ({count * image.voxel_mm3 / 1e3:.3g} ml)"
        for value, count in zip(values.tolist(), counts.tolist(), strict=True)
        if value != 0
    ]
    return _joined(found)


def _joined(found: list[str]) -> str:
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return (", ".join(found[:SHOWN]) or "nothing but 0") + more


def _volume(image: Image, label: int, layer: int) -> str:
    voxels = image.voxels if image.voxels.ndim == 3 else image.voxels[..., layer]
    return f"{np.count_nonzero(voxels == label) * image.voxel_mm3 / 1e3:.3g} ml"
