"""A box along the axes of the anatomy's frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ctrplan.anatomy.shape import PartEntry, PartShape, in_mm, point, register
from ctrplan.base.arrays import Array, lengths
from ctrplan.base.package import shown
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError
from ctrplan.storage.toml_document import Point, TomlTable, metres

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))  # turned outward
FACES = np.array([face for a, b, c, d in SIDES for face in ((a, b, c), (a, c, d))])


@shown
@dataclass(frozen=True, eq=False)
class Box(PartShape):
    """lower_m (3,), upper_m (3,): opposite corners, in the anatomy's frame. Raises InputError for what is no box."""

    kind = "box"
    is_formula = True
    lower_m: Array
    upper_m: Array

    def __post_init__(self) -> None:
        for name in ("lower_m", "upper_m"):
            object.__setattr__(self, name, point(name, getattr(self, name)))
        if not np.all(self.lower_m < self.upper_m):
            raise InputError("must exceed lower_m", key="upper_m", value=self.upper_m, unit="m")

    def distance(self, points_m: Array) -> Array:
        beyond = np.maximum(self.lower_m - points_m, points_m - self.upper_m)
        return np.asarray(lengths(np.maximum(beyond, 0.0)) + np.minimum(beyond.max(axis=1), 0.0))

    def box(self) -> tuple[Array, Array]:
        return self.lower_m, self.upper_m

    def surface(self) -> Surface:
        return Surface(self.lower_m + CORNERS * (self.upper_m - self.lower_m), FACES)

    def keys(self) -> dict[str, Any]:
        return {"lower_mm": in_mm(self.lower_m), "upper_mm": in_mm(self.upper_m)}


@register(Box)
class BoxEntry(PartEntry):
    """kind = "box"."""

    lower_mm: Point
    upper_mm: Point

    def shape(self, table: TomlTable) -> Box:
        if not all(lower < upper for lower, upper in zip(self.lower_mm, self.upper_mm, strict=True)):
            raise table.fault("must exceed lower_mm", "upper_mm")
        return Box(metres(self.lower_mm), metres(self.upper_mm))
