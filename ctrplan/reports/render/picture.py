"""Fragments -> a picture: colours of each pixel from near to far, each by what the nearer ones let through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.reports.render.body import Body
from ctrplan.reports.render.camera import Camera
from ctrplan.reports.render.fragments import Fragments, fragments, joined

OPAQUE = 0.9999
Picture = NDArray[np.uint8]  # (H, W, 3)


class Stage:
    """What stands still before a camera, drawn once; what moves is drawn into it."""

    def __init__(self, still: list[Body], camera: Camera, width: int, height: int, samples: int, sky: Array) -> None:
        """`samples` x `samples` rays a pixel; sky (2, 3) is the background's colour at the top and at the bottom."""
        self.camera, self.samples = camera, samples
        self.width, self.height = width * samples, height * samples
        share = (np.arange(self.height) + 0.5)[:, None, None] / self.height
        sky_rows = (1 - share) * sky[0] + share * sky[1]
        self.sky = np.broadcast_to(sky_rows, (self.height, self.width, 3)).reshape(-1, 3).astype(np.float32)
        self.still = self._fragments(still)
        self.empty = self.sky.copy()
        _compose(self.still, self.empty)

    def with_moving(self, moving: list[Body]) -> Picture:
        """The picture with bodies that move."""
        found, image = self._fragments(moving), self.empty.copy()
        touched = np.zeros(len(image), dtype=bool)
        touched[found.pixel] = True
        image[touched] = self.sky[touched]
        _compose(joined([found, self.still.of(touched[self.still.pixel])]), image)
        return self._reduced(image)

    def _fragments(self, bodies: list[Body]) -> Fragments:
        none = Fragments(np.zeros(0, np.int64), *(np.zeros(s, np.float32) for s in ((0,), (0, 3), (0,))))
        return joined([none, *(fragments(body, self.camera, self.width, self.height) for body in bodies)])

    def _reduced(self, image: NDArray[np.float32]) -> Picture:
        rows = image.reshape(self.height // self.samples, self.samples, self.width // self.samples, self.samples, 3)
        picture: Picture = (255 * rows.mean(axis=(1, 3)) + 0.5).astype(np.uint8)
        return picture


def _compose(found: Fragments, image: NDArray[np.float32]) -> None:
    """Draws fragments over image (P, 3), which is the background and is changed."""
    found = found.of(_not_hidden(found, len(image)))
    if not len(found.pixel):
        return
    order = np.lexsort((-found.near, found.pixel))
    pixel, opacity = found.pixel[order], np.minimum(found.opacity[order], OPAQUE).astype(np.float64)
    passed = np.cumsum(np.log1p(-opacity))
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    before = np.concatenate([[0.0], passed[:-1]])
    counts = np.diff(np.append(starts, len(pixel)))
    through = np.exp(before - np.repeat(before[starts], counts))
    shares = (through * opacity)[:, None] * found.colour[order]
    ends = starts + counts - 1
    left = np.exp(passed[ends] - before[starts])[:, None]
    image[pixel[starts]] = left * image[pixel[starts]] + np.add.reduceat(shares, starts, axis=0)


def _not_hidden(found: Fragments, pixels: int) -> NDArray[np.bool_]:
    """(K,) which fragments have nothing opaque before them."""
    solid = np.flatnonzero(found.opacity >= OPAQUE)
    nearest = np.zeros(pixels, dtype=np.float32)
    order = solid[np.argsort(found.near[solid], kind="stable")]
    nearest[found.pixel[order]] = found.near[order]  # the last one written is the nearest
    hidden: NDArray[np.bool_] = found.near < nearest[found.pixel]
    return ~hidden
