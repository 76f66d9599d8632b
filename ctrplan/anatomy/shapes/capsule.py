"""All points within a radius of a line segment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ctrplan.anatomy.shape import PartEntry, PartShape, in_mm, length, point, register
from ctrplan.base.arrays import Array, lengths
from ctrplan.base.package import shown
from ctrplan.base.surface import Surface, capsule
from ctrplan.storage.toml_document import Length, Point, TomlTable, metres


@shown
@dataclass(frozen=True, eq=False)
class Capsule(PartShape):
    """from_m (3,), to_m (3,), radius_m, in the anatomy's frame; a sphere where the two points are one.

    Raises InputError for what is no capsule.
    """

    kind = "capsule"
    is_formula = True
    from_m: Array
    to_m: Array
    radius_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "from_m", point("from_m", self.from_m))
        object.__setattr__(self, "to_m", point("to_m", self.to_m))
        object.__setattr__(self, "radius_m", length("radius_m", self.radius_m))

    def distance(self, points_m: Array) -> Array:
        axis, offset = self.to_m - self.from_m, points_m - self.from_m
        length_squared = float(axis @ axis)
        along = np.clip(offset @ axis / length_squared, 0.0, 1.0) if length_squared > 0 else np.zeros(len(points_m))
        return np.asarray(lengths(offset - along[:, None] * axis) - self.radius_m)

    def box(self) -> tuple[Array, Array]:
        lower, upper = np.minimum(self.from_m, self.to_m), np.maximum(self.from_m, self.to_m)
        return lower - self.radius_m, upper + self.radius_m

    def keys(self) -> dict[str, Any]:
        radius_mm = in_mm(np.array([self.radius_m]))[0]
        return {"from_mm": in_mm(self.from_m), "to_mm": in_mm(self.to_m), "radius_mm": radius_mm}

    def surface(self) -> Surface:
        return capsule(self.from_m, self.to_m, self.radius_m)


@register(Capsule)
class CapsuleEntry(PartEntry):
    """kind = "capsule"."""

    from_mm: Point
    to_mm: Point
    radius_mm: Length

    def shape(self, table: TomlTable) -> Capsule:
        return Capsule(metres(self.from_mm), metres(self.to_mm), self.radius_mm * 1e-3)
