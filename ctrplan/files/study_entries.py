"""What a study file may say: what is varied, and over which values. What is done with each is one of `task_kind.py`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from ctrplan.storage.number_ranges import Angle, Distance, Length, Name, Point, Tolerance, Vector

MOST_COUNT = 10**12
Count = Annotated[int, Meta(ge=1, le=MOST_COUNT)]
Seed = Annotated[int, Meta(ge=0, le=2**31 - 10**5 - 1)]
Tilt = Annotated[float, Meta(ge=0, lt=90)]
Scalar = str | float | int | bool
Points = Annotated[list[Point], Meta(min_length=1, max_length=1_000_000)]
Distribution = Literal["uniform", "normal", "lognormal", "triangular"]


class VaryEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[[vary]]: a key as in --set, and a list, a range, files or a distribution in its place."""

    key: Annotated[str, Meta(min_length=1, max_length=200)]
    values: Annotated[list[Scalar | list[Any]], Meta(min_length=1)] | None = None
    low: float | None = None  # of a range or a distribution
    high: float | None = None
    count: Count | None = None  # of values of a range
    files: Annotated[list[str], Meta(min_length=1)] | None = None  # patterns, relative to the study's folder
    distribution: Distribution | None = None  # drawn together with all others that have one, see [draws]
    mean: float | None = None
    sigma: Annotated[float, Meta(gt=0)] | None = None
    mode: float | None = None  # of a triangular distribution


class DrawsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[draws]: of all keys that have a distribution; "sobol" and "morris" are plans for a sensitivity analysis."""

    count: Count = 64  # rows; of "sobol" base samples and of "morris" trajectories, which have some rows each
    method: Literal["random", "sobol", "morris"] = "random"
    seed: Seed = 0


class TargetsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[targets]: points for the tip in the anatomy's frame: a list, or points of a volume or of a surface."""

    points_mm: Points | None = None
    file: str | None = None  # CSV with the columns x_mm, y_mm, z_mm
    within: str | None = None  # "anatomy" (where margins leave room), "anatomy.2" or a mesh file
    on: str | None = None  # the surface of such a part or file
    unit: Literal["mm", "cm", "m"] = "mm"  # of a mesh file
    box_mm: tuple[Point, Point] | None = None  # what a volume is limited to; alone: all of it
    step_mm: Annotated[float, Meta(ge=1e-3, le=1000)] | None = None  # of a grid, or between points of a surface
    count: Count | None = None  # points drawn at random in the place of a grid
    depth_mm: Distance = 0.0  # points of a volume keep at least this from its surface
    seed: Seed = 0
    tolerance_mm: Tolerance | None = None
    direction: Vector | None = None
    direction_tolerance_deg: Annotated[float, Meta(gt=0, le=180)] | None = None


class PoseEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """A base pose: the plate's origin, and which way it looks."""

    position_mm: Point
    direction: Vector | None = None  # of the robot's z axis, which the tubes leave the plate along
    quaternion_wxyz: tuple[float, float, float, float] | None = None


class PatchEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """A round patch of skin, or an opening along a line: positions, each with directions tilted from the normal."""

    center_mm: Point
    normal: Vector  # into the body
    along_mm: Point | None = None  # of an opening, which goes from center_mm to here
    radius_mm: Distance = 0.0
    step_mm: Length | None = None
    tilts_deg: Annotated[list[Tilt], Meta(min_length=1)] = msgspec.field(default_factory=lambda: [0.0])
    sides: Annotated[int, Meta(ge=1, le=360)] = 8  # directions of each tilt other than zero
    turns_deg: Annotated[list[Angle], Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [0.0]
    )  # about the direction


class BasesEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[bases]: where the robot stands: a list of poses, or a patch."""

    poses: Annotated[list[PoseEntry], Meta(min_length=1)] | None = None
    patch: PatchEntry | None = None


class KeepEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[keep]: plans that are written beside the table, and the number that says which are best and worst."""

    plans: Literal["none", "extremes", "all"] = "none"
    by: Name | None = None  # a column of the table; less is better
    numbers: list[str] = []  # columns to record; none named: all that there are


class StudyEntry(Struct, forbid_unknown_fields=True):
    """A study file."""

    task: dict[str, Any]  # of the kind that it names
    name: Name | None = None
    robot: str | None = None
    scenario: str | None = None
    seed: Seed = 0
    vary: list[VaryEntry] = []
    draws: DrawsEntry = DrawsEntry()
    targets: TargetsEntry | None = None
    bases: BasesEntry | None = None
    keep: KeepEntry = KeepEntry()
