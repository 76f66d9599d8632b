"""A volume: voxels, where each of them is, and in which frame that is said."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M


class ImageRefusal(Exception):
    """A rule that a volume breaks, as the end of a sentence; whoever reads it says where it was named."""


class UnfitImageRefusal(ImageRefusal):
    """Of an image that is whole, but too large or of a kind that is not read: it may lie beside what is meant."""


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
