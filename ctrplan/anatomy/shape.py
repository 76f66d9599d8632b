"""What a kind of obstacle or lumen says about itself, and the catalogue of kinds.

A kind is one file below anatomy/shapes/: a Shape, in metres, and the entry of a scenario file that describes one, in
millimetres. The clearance is only as sound as `Shape.distance`: it must never exceed the true distance to the surface,
and never change by more than a point moves.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from ctrplan.base.arguments import Number, require
from ctrplan.base.arrays import MM_PER_M, Array, numbers, read_only
from ctrplan.base.catalogue import AbstractStruct, Catalogue, guarded
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError
from ctrplan.storage.toml_document import Distance, TomlTable

LENGTH = Number(0, 1e3, "m", above=True)
Role = Literal["avoid", "inside"]


class PartShape(ABC):
    """A closed body in the anatomy's frame. Subclasses are dataclasses, compared by identity."""

    kind: ClassVar[str]  # as a scenario file names it
    is_formula: ClassVar[bool] = (
        False  # whether distances cost next to nothing, so that none is interpolated to save it
    )
    surface_error_m: float = 0.0  # what the surface may be off by from what it stands for: margins include it
    notes: tuple[str, ...] = ()  # what was repaired or left open in reading it, for whoever plans with it

    @abstractmethod
    def distance(self, points_m: Array) -> Array:
        """Distance (K,) [m] of points (K, 3) [m] to the surface, negative within the body."""

    @abstractmethod
    def box(self) -> tuple[Array, Array]:
        """Lower and upper corner (3,), (3,) [m] of a box around the body."""

    @abstractmethod
    def surface(self) -> Surface:
        """Triangles to draw."""

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.kind

    def keys(self) -> dict[str, Any]:
        """The keys of a scenario file that say the shape, in mm. Raises InputError unless a subclass knows them."""
        raise InputError(f"a {self.kind} made of arrays stands in no scenario file: write it to a file and name that")

    def content(self) -> Sequence[ArrayLike]:
        """Numbers that determine distances, for the key of cached grids: all fields unless a subclass knows better."""
        return [getattr(self, field.name) for field in fields(self)]  # type: ignore[arg-type]


class PartEntry(Struct, metaclass=AbstractStruct, forbid_unknown_fields=True, kw_only=True):
    """[[anatomy]]: what every kind has. The entry of a kind adds keys of its own and makes the shape."""

    kind: str
    role: Role = "avoid"
    margin_mm: Distance = 0.0

    @abstractmethod
    def shape(self, table: TomlTable) -> PartShape:
        """The shape that the entry describes; `table` reads files and says faults. Raises InputError."""


CATALOGUE: Catalogue[type[PartEntry]] = Catalogue("obstacle kind", "ctrplan.anatomy.shapes")
E_ = TypeVar("E_", bound=type[PartEntry])


def register(shape: type[PartShape]) -> Callable[[E_], E_]:
    """Adds a kind to the catalogue: the decorator of the entry that describes a `shape`.

    Raises InputError where the shape or its entry lacks something, or the kind has another's name.
    """

    def registered(entry: E_) -> E_:
        CATALOGUE.require(shape, ["kind"])
        if not is_dataclass(shape):
            raise InputError(f"{shape.__name__} must be a dataclass: its fields are the key of cached grids")
        CATALOGUE.require(entry, ())
        for own in (shape, entry):
            guarded(own, f"anatomy of kind {shape.kind}")
        CATALOGUE.add(shape.kind, entry, entry.__module__)
        return entry

    return registered


def length(name: str, value: float | None) -> float:
    """A finite length above zero [m]. Raises InputError otherwise."""
    require(name, value, LENGTH)
    return float(value)  # type: ignore[arg-type]


def in_mm(point_m: Array) -> list[float]:
    """A point (3,) [m] as a scenario file has it."""
    return [float(f"{x:.15g}") for x in (point_m * MM_PER_M).tolist()]


def point(name: str, value: Any) -> Array:
    """Three finite coordinates (3,) [m], read-only. Raises InputError otherwise."""
    array: Array = read_only(numbers(value, name))
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError("must be three finite coordinates", key=name, value=value, unit="m")
    return array
