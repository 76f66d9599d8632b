"""A volume: voxels, where each of them is and in which frame, the segments that it names; volumes kept while they are
needed by several structures.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import MM_PER_M, Array


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
    results = [
        f"{value:g} ({count * image.voxel_mm3 / 1e3:.3g} ml)"
        for value, count in zip(values.tolist(), counts.tolist(), strict=True)
        if value != 0
    ]
    return _joined(results)


def _joined(results: list[str]) -> str:
    more = f" and {len(results) - SHOWN} more" if len(results) > SHOWN else ""
    return (", ".join(results[:SHOWN]) or "nothing but 0") + more


def _volume(image: Image, label: int, layer: int) -> str:
    voxels = image.voxels if image.voxels.ndim == 3 else image.voxels[..., layer]
    return f"{np.count_nonzero(voxels == label) * image.voxel_mm3 / 1e3:.3g} ml"


MOST_KEPT_BYTES = 600_000_000  # of voxels that are kept; what was read last stays
Key = tuple[Path, int, int]  # with size and time of writing
_KEPT: ContextVar[dict[Key, Image] | None] = ContextVar("kept", default=None)


@contextmanager
def images_kept() -> Iterator[None]:
    """Within it an image that was read is not read again, unless its file has changed or others took its room."""
    if _KEPT.get() is not None:
        yield
        return
    before = _KEPT.set({})
    try:
        yield
    finally:
        _KEPT.reset(before)


def image_of(path: Path, read: Callable[[Path], Image]) -> Image:
    """The image of a file, read where it is not kept. Raises what `read` does."""
    images = _KEPT.get()
    if images is None:
        return read(path)
    told = path.stat()
    key = (path.resolve(), told.st_size, told.st_mtime_ns)
    if key not in images:
        images[key] = read(path)
        while len(images) > 1 and sum(image.voxels.nbytes for image in images.values()) > MOST_KEPT_BYTES:
            del images[next(iter(images))]
    return images[key]
