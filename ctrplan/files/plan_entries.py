"""What a plan.json must say for somebody else to judge it; docs/plan.schema.json has all of it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Numbers = list[float | None]  # None: not finite


class SourceEntry(Struct):
    """A file that a plan was made of."""

    sha256: str
    path: str | None = None


class JointEntry(Struct):
    """A joint of the drive."""

    name: str


class LegEntry(Struct):
    """A leg; joint values by name, each in deg or mm and in SI."""

    start: dict[str, dict[str, float]]
    end: dict[str, dict[str, float]]


class SamplesEntry(Struct):
    """Columns of the certificate's samples that are judged."""

    joints: Annotated[list[list[float]], Meta(min_length=1)]
    bound_m: Numbers
    predicted_m: Numbers
    clearance_m: Numbers | None = None


class TargetEntry(Struct):
    """A target of the plan."""

    leg: Annotated[int, Meta(ge=0)]


class ClosestEntry(Struct):
    """Where the robot comes closest to the anatomy."""

    clearance_m: float
    distance_m: float
    part: str
    tube: Annotated[int, Meta(ge=1)]
    point_m: tuple[float, float, float]
    leg: Annotated[int, Meta(ge=0)]
    path_mm: float
    joints: list[float]
    phi: list[float]


class CertificateEntry(Struct):
    """Claims that are judged."""

    valid: bool
    worst_bound_m: float | None
    worst_predicted_m: float | None
    min_clearance_m: float | None
    min_stability: float | None
    max_strain: float | None
    targets: Annotated[list[TargetEntry], Meta(min_length=1)]
    samples: SamplesEntry
    closest: ClosestEntry | None = None


class CompensationEntry(Struct):
    """What the joints were moved by for the predicted tip to arrive."""

    note: str


class SettlingEntry(Struct):
    """The oscillation that ends a plan."""

    amplitude_rad: float
    first_leg: Annotated[int, Meta(ge=0)]


class TrajectoryEntry(Struct):
    """How the trajectory was sampled."""

    period_s: Annotated[float, Meta(ge=1e-9, le=1e9)] | None


class PlanEntry(Struct):
    """A plan.json."""

    schema_version: int
    ctrplan_version: str
    scenario: SourceEntry
    robot: SourceEntry
    joints: list[JointEntry]
    legs: Annotated[list[LegEntry], Meta(min_length=1)]
    certificate: CertificateEntry
    trajectory: TrajectoryEntry
    settling: SettlingEntry | None = None
    compensation: CompensationEntry | None = None
