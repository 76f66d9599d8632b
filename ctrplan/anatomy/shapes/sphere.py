"""All points within a radius of a centre."""

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
class Sphere(PartShape):
    """center_m (3,), radius_m, in the anatomy's frame. Raises InputError for what is no sphere."""

    kind = "sphere"
    is_formula = True
    center_m: Array
    radius_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "center_m", point("center_m", self.center_m))
        object.__setattr__(self, "radius_m", length("radius_m", self.radius_m))

    def distance(self, points_m: Array) -> Array:
        return np.asarray(lengths(points_m - self.center_m) - self.radius_m)

    def box(self) -> tuple[Array, Array]:
        return self.center_m - self.radius_m, self.center_m + self.radius_m

    def keys(self) -> dict[str, Any]:
        return {"center_mm": in_mm(self.center_m), "radius_mm": in_mm(np.array([self.radius_m]))[0]}

    def surface(self) -> Surface:
        return capsule(self.center_m, self.center_m, self.radius_m)


@register(Sphere)
class SphereEntry(PartEntry):
    """kind = "sphere"."""

    center_mm: Point
    radius_mm: Length

    def shape(self, table: TomlTable) -> Sphere:
        return Sphere(metres(self.center_mm), self.radius_mm * 1e-3)
