"""A structure that moves: its surface in several phases of breath or heart beat, all of them to be kept clear of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.anatomy.shape import PartShape, Role
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError

SAMPLED = 3000  # vertices of a phase of which the way to the next one is looked at


@dataclass(frozen=True, eq=False)
class Phases(PartShape):
    """shapes: the structure in each phase, in their order. Avoided is their union, stayed inside of what they share.

    Raises InputError for fewer than two.
    """

    kind = "phases"
    shapes: tuple[PartShape, ...]
    role: Role
    motion_margin_m: float  # kept besides the margin, for places between the phases

    def __post_init__(self) -> None:
        """Checks that there are several."""
        if len(self.shapes) < 2:
            raise InputError("must hold two phases at least", key="files")

    def distance(self, points_m: Array) -> Array:
        """To the union, or to what all share."""
        every = [shape.distance(points_m) for shape in self.shapes]
        return np.asarray(np.min(every, axis=0) if self.role == "avoid" else np.max(every, axis=0))

    def box(self) -> tuple[Array, Array]:
        """Around all phases."""
        boxes = [shape.box() for shape in self.shapes]
        return np.min([lower for lower, _ in boxes], axis=0), np.max([upper for _, upper in boxes], axis=0)

    def surface(self) -> Surface:
        """The surfaces of all phases together."""
        surfaces = [shape.surface() for shape in self.shapes]
        before = np.cumsum([0] + [len(s.vertices_m) for s in surfaces[:-1]])
        faces = [s.faces + count for s, count in zip(surfaces, before, strict=True)]
        return Surface(np.concatenate([s.vertices_m for s in surfaces]), np.concatenate(faces))

    @property
    def name(self) -> str:
        """Those of the phases."""
        return ", ".join(shape.name for shape in self.shapes)

    def content(self) -> Sequence[ArrayLike]:
        """The content of all phases."""
        return [numbers for shape in self.shapes for numbers in shape.content()]

    @property
    def surface_error_m(self) -> float:  # type: ignore[override]
        """The largest of the phases', and the margin of motion."""
        return self.motion_margin_m + max(shape.surface_error_m for shape in self.shapes)

    @property
    def notes(self) -> tuple[str, ...]:  # type: ignore[override]
        """Those of the phases, and whether the margin is what a straight way between phases would need."""
        own = tuple(f"{shape.name} {note}" for shape in self.shapes for note in shape.notes)
        half_mm, given_mm = self.apart_m() / 2 * MM_PER_M, self.motion_margin_m * MM_PER_M
        if half_mm <= given_mm:
            return own
        short = f"moves up to {2 * half_mm:.2g} mm from one phase to the next, halfway {half_mm:.2g} mm away from both"
        return (*own, f"{short}: more than motion_margin_mm = {given_mm:g}")

    def apart_m(self) -> float:
        """How far the surface of one phase lies from that of the next, at the most."""
        apart = 0.0
        for one, other in zip(self.shapes[:-1], self.shapes[1:], strict=True):
            for a, b in ((one, other), (other, one)):
                vertices = a.surface().vertices_m
                apart = max(apart, float(np.abs(b.distance(vertices[:: len(vertices) // SAMPLED + 1])).max()))
        return apart

    @property
    def image_box_m(self) -> Array | None:
        """Corners of the first phase's image, where they are of images."""
        box: Array | None = getattr(self.shapes[0], "image_box_m", None)
        return box
