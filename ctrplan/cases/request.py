"""What a case is asked for: scans, points, roles and numbers; a later run keeps what it does not say anew."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ctrplan.base.units import MM_PER_M

RADIUS_MM = 4.0  # of the patch of base poses, where none is said
Place = tuple[float, float, float] | str  # mm in the case's frame; or a file of markups, a label in one, a structure


@dataclass(frozen=True)
class Request:
    """None where nothing is said. Lengths in mm, angles in deg, as in the files that a case writes."""

    inputs: tuple[str, ...] | None = None  # files and folders
    targets: tuple[Place, ...] | None = None
    entries: tuple[Place, ...] | None = None
    frame: str | None = None  # of the case, in which numbers are said
    file_frame: str | None = None  # of files that do not say theirs
    unit: str | None = None  # of meshes
    series: str | None = None  # UID, of a DICOM folder with several
    repair: str | None = None  # of their openings: holes, caps or off
    lumens: tuple[str, ...] | None = None
    avoids: tuple[str, ...] | None = None
    ignored: tuple[str, ...] | None = None
    phases: tuple[tuple[str, ...], ...] | None = None  # files of one structure each
    motion_margin_mm: float | None = None  # for places between phases
    robot: str | None = None
    margin_mm: float | None = None
    surface_error_mm: float | None = None
    tolerance_mm: float | None = None
    sheath_mm: float | None = None
    radius_mm: float | None = None
    cone_deg: float | None = None
    candidates: int | None = None
    bases: int | None = None
    seed: int | None = None
    time_s: float | None = None

    def over(self, earlier: Request) -> Request:
        """What is said here, and what the earlier run said of the rest; named inputs begin a new case."""
        if self.inputs is not None:
            return self
        said = {name: value for name, value in vars(self).items() if value is not None}
        return dataclasses.replace(earlier, **said)

    def part(self, *names: str) -> dict[str, Any]:
        """Some of it, by name."""
        return {name: getattr(self, name) for name in names}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Request:
        """As JSON had it."""
        known = {field.name for field in dataclasses.fields(cls)}
        return cls(**{name: _tuples(value) for name, value in content.items() if name in known})


def patch_radius_m(request: Request) -> float:
    """[m] around an entry in which base poses are looked for."""
    return (RADIUS_MM if request.radius_mm is None else request.radius_mm) / MM_PER_M


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
