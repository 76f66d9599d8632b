"""What of a volume is meant: a label, a named segment, or grey values of a range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.images.image import Image, ImageRefusal
from ctrplan.anatomy.images.segments import listed

PAD = 2  # voxels around what is chosen, outside it

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Choice:
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
class Structure:
    """What is chosen, cropped: grid (nz, ny, nx), whose voxel (0, 0, 0) is `first` (3,) along (x, y, z) of the image.

    inside: which voxels belong. above: for a range of grey values how far each is within it, else None.
    at_edge: whether it goes on where the image ends.
    """

    inside: Mask
    above: NDArray[np.float32] | None
    first: NDArray[np.int64]
    at_edge: bool


def structure(image: Image, choice: Choice) -> Structure:
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
    return Structure(np.pad(inside[crop], short), above, first, at_edge)


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


def _labelled(image: Image, choice: Choice) -> tuple[NDArray[Any], Mask]:
    label, layer = choice.label, 0
    if choice.segment is not None:
        found = [s for s in image.segments if s.name == choice.segment]
        if not image.segments:
            raise ImageRefusal(f"names no segments: say a label of {listed(image)}")
        if len(found) != 1:
            there = "no segment" if not found else f"{len(found)} segments"
            raise ImageRefusal(f"has {there} of that name, but {listed(image)}")
        label, layer = found[0].label, found[0].layer
    elif label is None:
        raise ImageRefusal(f"needs label, segment, above or below to say what is meant of {listed(image)}")
    elif image.voxels.ndim == 4:
        raise ImageRefusal(f"has segments that overlap: say a segment of {listed(image)}")
    voxels = _layer(image, layer)
    inside: Mask = voxels == label
    if not inside.any():
        raise ImageRefusal(f"has no voxel of that label, but {listed(image)}")
    return voxels, inside


def _in_range(voxels: NDArray[Any], choice: Choice) -> Mask:
    inside: Mask = np.ones(voxels.shape, bool) if choice.above is None else voxels > choice.above
    if choice.below is not None:
        inside &= voxels < choice.below
    return inside


def _margin(voxels: NDArray[Any], choice: Choice, short: list[tuple[int, int]]) -> NDArray[np.float32]:
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
