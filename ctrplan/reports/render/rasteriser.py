"""Triangles to a picture: what a pinhole camera sees of bodies, glass among them, without a screen or OpenGL.

Triangles become fragments: a colour and its share for every pixel that a triangle covers, with its nearness. A pixel
takes the colours of its fragments from near to far, each by what the nearer ones let through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface

LIGHTS = (np.array([-0.35, 0.6, -0.72]), np.array([0.8, 0.1, -0.3]))  # directions to them, camera's frame
STRENGTHS = (0.60, 0.20)
AMBIENT, SHINE, SHINE_POWER = 0.44, 0.20, 24
OPAQUE = 0.9999
Picture = NDArray[np.uint8]  # (H, W, 3)


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye, an orthonormal frame and how much is seen; anatomy's frame, m."""

    eye_m: Array  # (3,)
    axes: Array  # (3, 3) rows: to the right, up, forward
    half_view: float  # tangent of half the angle from the middle to the top of the picture
    near_m: float = 1e-3  # what is nearer is not seen
    lamp_m: float = np.inf  # how far its own light reaches; infinite where the scene is lit from elsewhere

    def seen(self, points_m: Array) -> Array:
        """Points (..., 3) in the camera's frame: right, up, forward [m]."""
        seen: Array = (points_m - self.eye_m) @ self.axes.T
        return seen


@dataclass(frozen=True, eq=False)
class Body:
    """A surface to draw. Glass covers little where it is looked at squarely, and more at its rim."""

    surface: Surface
    colour: Array  # (3,) in [0, 1], or (V, 3) of each vertex
    opacity: float = 1.0  # seen squarely
    rim: float = 1.0  # seen along it


def vertex_normals(surface: Surface) -> Array:
    """(V, 3) unit vectors, means of the triangles around each vertex by their areas; zero where there are none."""
    a, b, c = np.moveaxis(surface.vertices_m[surface.faces], 1, 0)
    across = np.cross(b - a, c - a)
    corners = surface.faces.T.ravel()
    count = len(surface.vertices_m)
    normal = np.stack([np.bincount(corners, np.tile(row, 3), minlength=count) for row in across.T], axis=1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit: Array = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    return unit


@dataclass(frozen=True, eq=False)
class Fragments:
    """Colours for pixels, K of them in no order."""

    pixel: NDArray[np.int64]  # (K,) row * width + column
    near: NDArray[np.float32]  # (K,) one over the distance forward [1/m]: larger is nearer
    colour: NDArray[np.float32]  # (K, 3)
    opacity: NDArray[np.float32]  # (K,)

    def where(self, mask: NDArray[np.bool_]) -> Fragments:
        """The fragments of a mask (K,)."""
        return Fragments(self.pixel[mask], self.near[mask], self.colour[mask], self.opacity[mask])


def _joined(parts: list[Fragments]) -> Fragments:
    names = ("pixel", "near", "colour", "opacity")
    return Fragments(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def fragments(body: Body, camera: Camera, width: int, height: int) -> Fragments:
    """What a camera of width x height pixels sees of a body, hidden parts included."""
    seen = camera.seen(body.surface.vertices_m)
    lit = _lit(body, camera, seen)
    corners = _clipped(np.concatenate([seen, lit], axis=1)[body.surface.faces], camera.near_m)
    forward = corners[..., 2]
    scale = height / (2 * camera.half_view)
    x = width / 2 + scale * corners[..., 0] / forward
    y = height / 2 - scale * corners[..., 1] / forward
    channels = np.concatenate([corners[..., 3:], 1 / forward[..., None]], axis=-1)
    return _filled(x, y, channels, width, height)


def _lit(body: Body, camera: Camera, seen: Array) -> Array:
    """(V, 4) colour and opacity of each vertex; both sides of a surface are lit alike."""
    normal = vertex_normals(body.surface) @ camera.axes.T
    apart = np.linalg.norm(seen, axis=1, keepdims=True)
    toward = -seen / np.maximum(apart, 1e-12)
    facing = np.sum(normal * toward, axis=1)
    normal = np.where(facing[:, None] < 0, -normal, normal)
    facing = np.abs(facing)
    if np.isfinite(camera.lamp_m):
        light = (0.12 + 0.88 * facing) / (1 + (apart[:, 0] / camera.lamp_m) ** 2)
        shine = SHINE * facing ** (2 * SHINE_POWER) / (1 + (apart[:, 0] / camera.lamp_m) ** 2)
    else:
        light, shine = np.full(len(seen), AMBIENT), np.zeros(len(seen))
        for direction, strength in zip(LIGHTS, STRENGTHS, strict=True):
            light = light + strength * np.maximum(normal @ direction, 0.0)
            half = toward + direction
            half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
            shine = shine + SHINE * np.maximum(np.sum(normal * half, axis=1), 0.0) ** SHINE_POWER
    colour = np.minimum(body.colour * light[:, None] + shine[:, None], 1.0)
    opacity = body.opacity + (body.rim - body.opacity) * (1 - facing) ** 2
    return np.column_stack([colour, opacity])


def _clipped(corners: Array, near_m: float) -> Array:
    """Triangles (T, 3, C), third column forward: those in front of the near plane, and what is left of those across."""
    behind = corners[..., 2] < near_m
    count = behind.sum(axis=1)
    parts = [corners[count == 0]]
    for lonely, whole in ((1, 2), (2, 1)):  # corners behind, and corners left
        triangles = corners[count == lonely]
        odd = behind[count == lonely] if lonely == 1 else ~behind[count == lonely]
        first = np.argmax(odd, axis=1)
        rows = np.arange(len(triangles))
        a, b, c = (triangles[rows, (first + k) % 3] for k in range(3))
        ab, ac = _cut(a, b, near_m), _cut(a, c, near_m)
        if whole == 1:
            parts.append(np.stack([a, ab, ac], axis=1))
        else:
            parts += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(parts)


def _cut(a: Array, b: Array, near_m: float) -> Array:
    """Where the edges from a to b (T, C) cross the near plane."""
    share = (near_m - a[:, 2:3]) / (b[:, 2:3] - a[:, 2:3])
    return a + share * (b - a)


def _filled(x: Array, y: Array, channels: Array, width: int, height: int) -> Fragments:
    """Pixels whose middles lie in triangles x, y (T, 3), row by row; channels (T, 3, 5) are linear in the picture."""
    top = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, height).astype(np.int64)
    bottom = np.clip(np.ceil(y.max(axis=1) - 0.5), 0, height).astype(np.int64)
    triangle, row = _runs(top, bottom)
    left, right = _crossings(x[triangle], y[triangle], row.astype(np.float64) + 0.5)
    first = np.clip(np.ceil(left - 0.5), 0, width).astype(np.int64)
    last = np.clip(np.ceil(right - 0.5), 0, width).astype(np.int64)
    span, column = _runs(first, last)
    triangle, row = triangle[span], row[span]
    by_x, by_y = _slopes(x, y, channels)
    dx, dy = column + 0.5 - x[triangle, 0], row + 0.5 - y[triangle, 0]
    values = channels[triangle, 0] + dx[:, None] * by_x[triangle] + dy[:, None] * by_y[triangle]
    shown = values.astype(np.float32)
    return Fragments(row * width + column, shown[:, 4], shown[:, :3].clip(0, 1), shown[:, 3].clip(0, 1))


def _runs(first: NDArray[np.int64], end: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Whole numbers from first to end (K,), end excluded, one run after the other; with the run that each is of."""
    counts = np.maximum(end - first, 0)
    run = np.repeat(np.arange(len(first)), counts)
    return run, np.arange(len(run)) - np.repeat(np.cumsum(counts) - counts, counts) + first[run]


def _crossings(x: Array, y: Array, at: Array) -> tuple[Array, Array]:
    """Where the line y = at (K,) enters and leaves triangles x, y (K, 3)."""
    left, right = np.full(len(at), np.inf), np.full(len(at), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        crosses = (y[:, a] <= at) != (y[:, b] <= at)
        height = np.where(crosses, y[:, b] - y[:, a], 1.0)
        place = x[:, a] + (at - y[:, a]) / height * (x[:, b] - x[:, a])
        left = np.where(crosses, np.minimum(left, place), left)
        right = np.where(crosses, np.maximum(right, place), right)
    empty = left > right
    return np.where(empty, 0.0, left), np.where(empty, 0.0, right)


def _slopes(x: Array, y: Array, channels: Array) -> tuple[Array, Array]:
    """Change of the channels (T, C) per pixel to the right and down; 0 for triangles seen from their edge."""
    x1, x2, y1, y2 = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], y[:, 1] - y[:, 0], y[:, 2] - y[:, 0]
    area = x1 * y2 - x2 * y1
    scale = np.divide(1.0, area, out=np.zeros_like(area), where=np.abs(area) > 1e-9)[:, None]
    c1, c2 = channels[:, 1] - channels[:, 0], channels[:, 2] - channels[:, 0]
    by_x = (c1 * y2[:, None] - c2 * y1[:, None]) * scale
    by_y = (c2 * x1[:, None] - c1 * x2[:, None]) * scale
    return by_x, by_y


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
        added, image = self._fragments(moving), self.empty.copy()
        touched = np.zeros(len(image), dtype=bool)
        touched[added.pixel] = True
        image[touched] = self.sky[touched]
        _compose(_joined([added, self.still.where(touched[self.still.pixel])]), image)
        return self._reduced(image)

    def _fragments(self, bodies: list[Body]) -> Fragments:
        none = Fragments(np.zeros(0, np.int64), *(np.zeros(s, np.float32) for s in ((0,), (0, 3), (0,))))
        return _joined([none, *(fragments(body, self.camera, self.width, self.height) for body in bodies)])

    def _reduced(self, image: NDArray[np.float32]) -> Picture:
        rows = image.reshape(self.height // self.samples, self.samples, self.width // self.samples, self.samples, 3)
        picture: Picture = (255 * rows.mean(axis=(1, 3)) + 0.5).astype(np.uint8)
        return picture


def _compose(drawn: Fragments, image: NDArray[np.float32]) -> None:
    """Draws fragments over image (P, 3), which is the background and is changed."""
    drawn = drawn.where(_not_hidden(drawn, len(image)))
    if not len(drawn.pixel):
        return
    order = np.lexsort((-drawn.near, drawn.pixel))
    pixel, opacity = drawn.pixel[order], np.minimum(drawn.opacity[order], OPAQUE).astype(np.float64)
    passed = np.cumsum(np.log1p(-opacity))
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    before = np.concatenate([[0.0], passed[:-1]])
    counts = np.diff(np.append(starts, len(pixel)))
    through = np.exp(before - np.repeat(before[starts], counts))
    shares = (through * opacity)[:, None] * drawn.colour[order]
    ends = starts + counts - 1
    left = np.exp(passed[ends] - before[starts])[:, None]
    image[pixel[starts]] = left * image[pixel[starts]] + np.add.reduceat(shares, starts, axis=0)


def _not_hidden(drawn: Fragments, pixels: int) -> NDArray[np.bool_]:
    """(K,) which fragments have nothing opaque before them."""
    solid = np.flatnonzero(drawn.opacity >= OPAQUE)
    nearest = np.zeros(pixels, dtype=np.float32)
    order = solid[np.argsort(drawn.near[solid], kind="stable")]
    nearest[drawn.pixel[order]] = drawn.near[order]  # the last one written is the nearest
    hidden: NDArray[np.bool_] = drawn.near < nearest[drawn.pixel]
    return ~hidden
