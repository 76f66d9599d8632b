"""Triangles -> fragments: a colour and its share for every pixel that a triangle covers, with its nearness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.reports.render.body import Body, vertex_normals
from ctrplan.reports.render.camera import Camera

LIGHTS = (np.array([-0.35, 0.6, -0.72]), np.array([0.8, 0.1, -0.3]))  # directions to them, camera's frame
STRENGTHS = (0.60, 0.20)
AMBIENT, SHINE, SHINE_POWER = 0.44, 0.20, 24


@dataclass(frozen=True, eq=False)
class Fragments:
    """K of them, in no order."""

    pixel: NDArray[np.int64]  # (K,) row * width + column
    near: NDArray[np.float32]  # (K,) one over the distance forward [1/m]: larger is nearer
    colour: NDArray[np.float32]  # (K, 3)
    opacity: NDArray[np.float32]  # (K,)

    def of(self, which: NDArray[np.bool_]) -> Fragments:
        """Some of them."""
        return Fragments(self.pixel[which], self.near[which], self.colour[which], self.opacity[which])


def joined(parts: list[Fragments]) -> Fragments:
    """All of them."""
    return Fragments(
        np.concatenate([part.pixel for part in parts]),
        np.concatenate([part.near for part in parts]),
        np.concatenate([part.colour for part in parts]),
        np.concatenate([part.opacity for part in parts]),
    )


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
