"""A structure of a volume (a label, a named segment, grey values of a range) and its surface between the voxels.

A label map says of each voxel's centre whether it is inside. Its occupancy is smoothed by the kernel G - s^2 lap(G), G
being a normal distribution of s = SIGMA voxels. Within any plane through its middle it has no second moment, so that
the level 1/2 stays where a curved surface is (a normal distribution alone draws a tube of radius R in by s^2 / (2 R)).
Every voxel's centre stays on its side. Grey values need no smoothing: the surface is where they cross the threshold.
An image is kept while several structures of it are read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.image import Image, ImageRefusal
from ctrplan.base.arrays import Array

PAD = 2  # voxels around what is chosen, outside it

SHOWN = 12  # labels in a sentence

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class StructureChoice:
    """One of label, segment, and a range of grey values, of which one end is enough."""

    label: int | None = None
    segment: str | None = None
    above: float | None = None
    below: float | None = None

    @property
    def is_range(self) -> bool:
        """Whether grey values are meant."""
        return self.above is not None or self.below is not None


@dataclass(frozen=True, eq=False)
class ImageStructure:
    """What is chosen, cropped: grid (nz, ny, nx), whose voxel (0, 0, 0) is `first` (3,) along (x, y, z) of the image.

    inside: which voxels belong. above: for a range of grey values how far each is within it, else None.
    at_edge: whether it goes on where the image ends.
    """

    inside: Mask
    above: NDArray[np.float32] | None
    first: NDArray[np.int64]
    at_edge: bool


def structure(image: Image, choice: StructureChoice) -> ImageStructure:
    """The chosen voxels. Raises ImageRefusal where there are none, with what there is."""
    if choice.is_range:
        voxels = _layer(image, 0)
        inside = _in_range(voxels, choice)
        if not inside.any():
            low, high = float(voxels.min()), float(voxels.max())
            raise ImageRefusal(f"has no voxel in that range: its values go from {low:g} to {high:g}")
    else:
        voxels, inside = _labelled(image, choice)
    box = [_extent(inside, axis) for axis in range(3)]
    at_edge = any(low == 0 or high == size for (low, high), size in zip(box, inside.shape, strict=True))
    crop = tuple(slice(max(low - PAD, 0), min(high + PAD, n)) for (low, high), n in zip(box, inside.shape, strict=True))
    short = [(PAD - (low - c.start), PAD - (c.stop - high)) for (low, high), c in zip(box, crop, strict=True)]
    first = np.array([c.start - before for c, (before, _) in zip(crop, short, strict=True)][::-1])
    above = _margin(voxels[crop], choice, short) if choice.is_range else None
    return ImageStructure(np.pad(inside[crop], short), above, first, at_edge)


def has_thin_parts(inside: Mask) -> bool:
    """Whether parts of a structure are too thin for a cube of 3 voxels: nowhere near one that fits."""
    core = _spread(_spread(~_spread(~inside)))
    return bool((inside & ~core).any())


def _spread(mask: Mask) -> Mask:
    """A mask grown by a voxel to all sides, corners included."""
    for axis in range(3):
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        grown = mask.copy()
        grown[tuple(ahead)] |= mask[tuple(behind)]
        grown[tuple(behind)] |= mask[tuple(ahead)]
        mask = grown
    return mask


def _layer(image: Image, layer: int) -> NDArray[Any]:
    return image.voxels if image.voxels.ndim == 3 else image.voxels[..., layer]


def volume_of(image: Image, label: int, layer: int) -> str:
    """Volume of the voxels of a label in one of the layers, in ml."""
    return f"{np.count_nonzero(_layer(image, layer) == label) * image.voxel_mm3 / 1e3:.3g} ml"


def _labelled(image: Image, choice: StructureChoice) -> tuple[NDArray[Any], Mask]:
    label, layer = choice.label, 0
    if choice.segment is not None:
        results = [s for s in image.segments if s.name == choice.segment]
        if not image.segments:
            raise ImageRefusal(f"names no segments: say a label of {listed(image)}")
        if len(results) != 1:
            there = "no segment" if not results else f"{len(results)} segments"
            raise ImageRefusal(f"has {there} of that name, but {listed(image)}")
        label, layer = results[0].label, results[0].layer
    elif label is None:
        raise ImageRefusal(f"needs label, segment, above or below to say what is meant of {listed(image)}")
    elif image.voxels.ndim == 4:
        raise ImageRefusal(f"has segments that overlap: say a segment of {listed(image)}")
    voxels = _layer(image, layer)
    inside: Mask = voxels == label
    if not inside.any():
        raise ImageRefusal(f"has no voxel of that label, but {listed(image)}")
    return voxels, inside


def _in_range(voxels: NDArray[Any], choice: StructureChoice) -> Mask:
    inside: Mask = np.ones(voxels.shape, bool) if choice.above is None else voxels > choice.above
    if choice.below is not None:
        inside &= voxels < choice.below
    return inside


def _margin(voxels: NDArray[Any], choice: StructureChoice, short: list[tuple[int, int]]) -> NDArray[np.float32]:
    """How far grey values are within the range; beyond the image as far outside as its last voxels are inside."""
    values = voxels.astype(np.float32)
    above = np.full(values.shape, np.inf, np.float32) if choice.above is None else values - np.float32(choice.above)
    if choice.below is not None:
        np.minimum(above, np.float32(choice.below) - values, out=above)
    padded = np.pad(above, short, mode="edge")
    beyond = np.pad(np.zeros(above.shape, bool), short, constant_values=True)
    padded[beyond] = -np.abs(padded[beyond])
    return padded


def _extent(inside: Mask, axis: int) -> tuple[int, int]:
    """First and one past the last plane across an axis that holds any."""
    others = tuple(k for k in range(3) if k != axis)
    there = np.flatnonzero(inside.any(axis=others))
    return int(there[0]), int(there[-1]) + 1


SIGMA = 1.5  # voxels
TRUNCATED = 3.0  # standard deviations
HALO = math.ceil(TRUNCATED * SIGMA) + 1  # planes that smoothing and second differences look at on either side
LEAST = 0.02  # by which a voxel stays on its side of 1/2
TINY = 1e-6  # of the largest value: what grey values differ from the threshold by at least
SLAB = 24  # planes looked at together
LABEL_ERROR, THIN_ERROR, GREY_ERROR = (
    0.6,
    0.9,
    0.15,
)  # of the widest voxel, see benchmarks/scans.py: what a surface is off by at most
CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)  # (x, y, z)

Grid = NDArray[np.float32]
Indices = NDArray[np.int64]


def level_surface(chosen: ImageStructure) -> tuple[Array, Indices]:
    """Vertices (V, 3) along (x, y, z) in voxels of the structure's grid; triangles (F, 3), closed and outward."""
    shape = chosen.inside.shape
    keys, places, corners, count = [], [], [], 0
    for first in range(0, shape[0] - 1, SLAB):
        planes = slice(first, min(first + SLAB + 1, shape[0]))
        vertices, faces = _marched(_heights(chosen, planes))
        vertices[:, 2] += first
        keys.append(_edge_keys(vertices, shape))
        places.append(vertices)
        corners.append(faces + count)
        count += len(vertices)
    _, rows, index = np.unique(np.concatenate(keys), return_index=True, return_inverse=True)
    faces = index.reshape(-1)[np.concatenate(corners)]
    return np.concatenate(places)[rows], np.ascontiguousarray(faces, dtype=np.int64)


def _heights(chosen: ImageStructure, planes: slice) -> Grid:
    """How far inside the voxels of some planes are, positive inside; only the sign and ratios have a meaning."""
    from scipy.ndimage import gaussian_filter  # slow to import

    inside = chosen.inside[planes]
    if chosen.above is not None:
        values = chosen.above[planes]
        return _on_its_side(values, inside, TINY * max(float(np.abs(values).max()), 1e-30))
    start = max(planes.start - HALO, 0)
    around = chosen.inside[start : planes.stop + HALO]
    smooth = gaussian_filter(around.astype(np.float32), SIGMA, truncate=TRUNCATED, mode="constant")
    sharp = (smooth - SIGMA**2 * _laplacian(smooth))[planes.start - start :][: len(inside)] - np.float32(0.5)
    return _on_its_side(sharp, inside, LEAST)


def _on_its_side(values: Grid, inside: Mask, least: float) -> Grid:
    """The values, at least so far above zero inside and below it outside."""
    return np.asarray(np.where(inside, np.maximum(values, least), np.minimum(values, -least)), dtype=np.float32)


def _laplacian(values: Grid) -> Grid:
    """Sum of the second differences; zeros beyond the ends."""
    total = -6 * values
    for axis in range(3):
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        total[tuple(behind)] += values[tuple(ahead)]
        total[tuple(ahead)] += values[tuple(behind)]
    return total


def _marched(heights: Grid) -> tuple[Array, Indices]:
    """Surface of a slab (nz, ny, nx); only cells that it goes through are handed to marching cubes."""
    import igl  # slow to import

    inside = (heights > 0).view(np.int8)
    sums = inside[:-1] + inside[1:]
    sums = sums[:, :-1] + sums[:, 1:]
    sums = sums[:, :, :-1] + sums[:, :, 1:]
    cell = np.argwhere((sums > 0) & (sums < 8))[:, ::-1]
    if not len(cell):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    _, ny, nx = heights.shape
    strides = np.array([1, nx, nx * ny])
    nodes = (cell @ strides)[:, None] + CORNERS @ strides
    number = np.zeros(heights.size, np.int64)
    number[nodes.reshape(-1)] = 1
    used = np.flatnonzero(number)
    number[used] = np.arange(len(used))
    where = np.stack([used % nx, used // nx % ny, used // (nx * ny)], axis=1).astype(np.float64)
    values = heights.reshape(-1)[used].astype(np.float64)
    vertices, faces, _ = igl.marching_cubes(values, where, number[nodes], 0.0)
    return np.array(vertices), np.asarray(faces)[:, ::-1]


def _edge_keys(vertices: Array, shape: tuple[int, ...]) -> Indices:
    """One number for the lattice edge that each vertex lies on, so that slabs can be sewn together."""
    base = np.floor(vertices)
    share = np.minimum(vertices - base, base + 1 - vertices)
    nz, ny, nx = shape
    node = base.astype(np.int64) @ np.array([1, nx, nx * ny])
    key: Indices = node * 3 + share.argmax(axis=1)
    return key


def listed(image: Image) -> str:
    """What there is to choose from: names, labels and their volumes."""
    if image.segments:
        return _joined([f"{s.name!r} ({volume_of(image, s.label, s.layer)})" for s in image.segments])
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
    stat = path.stat()
    key = (path.resolve(), stat.st_size, stat.st_mtime_ns)
    if key not in images:
        images[key] = read(path)
        while len(images) > 1 and sum(image.voxels.nbytes for image in images.values()) > MOST_KEPT_BYTES:
            del images[next(iter(images))]
    return images[key]
