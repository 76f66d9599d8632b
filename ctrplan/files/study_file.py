"""Study files (TOML): what is varied and over which values, read strictly."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.storage.toml_document import (
    Angle,
    Distance,
    Document,
    Length,
    Name,
    Point,
    Tolerance,
    Vector,
)

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
    unit: Literal["mm", "cm", "m", "in"] | None = None  # of a mesh file; by default mm, of glTF m
    frame: Frame | None = None  # of a mesh file that does not say its own
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


def checked_study(document: Document) -> StudyEntry:
    """The content of a study file as entries. Raises InputError."""
    entry = document.to(StudyEntry)
    if (entry.robot is None) == (entry.scenario is None):
        rule = "is missing, or robot in its place" if entry.robot is None else "and robot exclude each other"
        raise document.fault(rule, "scenario")
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    if entry.robot is not None and entry.bases is not None:
        raise document.fault("needs a scenario: a robot alone stands nowhere", "bases")
    for k in range(len(entry.vary)):
        _check_vary(entry, document, k)
    if entry.targets is not None:
        check_targets(entry.targets, document)
    if entry.bases is not None and (entry.bases.poses is None) == (entry.bases.patch is None):
        raise document.fault("must have one of poses and patch", "bases")
    return entry


def _check_vary(entry: StudyEntry, document: Document, k: int) -> None:
    """Raises InputError unless one [[vary]] says one thing."""
    vary = entry.vary[k]
    if any(other.key == vary.key for other in entry.vary[:k]):
        raise document.fault("is varied twice", "vary", k, "key")
    if table := _taken(vary.key, entry):
        raise document.fault(f"is said by [{table}] already", "vary", k, "key")
    is_range = vary.count is not None
    ways = (vary.values is not None) + (vary.files is not None) + (vary.distribution is not None) + is_range
    if ways != 1:
        raise document.fault("must have one of values, files, distribution, and low, high, count", "vary", k)
    needed = {
        "range": ("low", "high"),
        "uniform": ("low", "high"),
        "triangular": ("low", "high", "mode"),
        "normal": ("mean", "sigma"),
        "lognormal": ("mean", "sigma"),
    }.get("range" if is_range else vary.distribution or "", ())
    for name in ("low", "high", "mean", "sigma", "mode"):
        if (getattr(vary, name) is None) == (name in needed):
            what = vary.distribution or ("a range" if is_range else "a list")
            raise document.fault("is missing" if name in needed else f"does not go with {what}", "vary", k, name)
    if vary.low is not None and vary.high is not None and not vary.low < vary.high:
        raise document.fault(f"must be below high = {vary.high:g}", "vary", k, "low")
    if vary.mode is not None and not (vary.low or 0.0) <= vary.mode <= (vary.high or 0.0):
        raise document.fault("must lie from low to high", "vary", k, "mode")


POSE_KEYS = ("", "position_mm", "quaternion_wxyz", "direction", "look_at", "roll_deg")
GOAL_KEYS = ("tolerance_mm", "direction", "direction_tolerance_deg")


def _taken(key: str, entry: StudyEntry) -> str:
    """The table that says what a key of the scenario is for every task; empty where none does."""
    root, _, rest = key.partition(".")
    if root == "base" and entry.bases is not None and rest in POSE_KEYS:
        return "bases"
    is_free = root == "goal" and rest in GOAL_KEYS and getattr(entry.targets, rest, None) is None
    is_used = is_free and entry.task.get("kind") != "ik"  # which has keys of its own for them
    return "targets" if root in ("goal", "target") and entry.targets is not None and not is_used else ""


def check_targets(targets: TargetsEntry, document: Document) -> None:
    """Raises InputError unless [targets] says one set of points."""
    listed = (targets.points_mm is not None) + (targets.file is not None)
    shaped = (targets.within is not None) + (targets.on is not None)
    if listed + shaped != 1 and not (listed + shaped == 0 and targets.box_mm is not None):
        raise document.fault("must have one of points_mm, file, within, on and box_mm", "targets")
    spaced = (targets.step_mm is not None) + (targets.count is not None)
    if listed and (spaced or targets.box_mm is not None or targets.depth_mm):
        key = next(key for key in ("step_mm", "count", "box_mm", "depth_mm") if key in document.content["targets"])
        raise document.fault("does not go with points that are listed", "targets", key)
    if not listed and spaced != 1:
        raise document.fault("must have one of step_mm and count", "targets")
    if targets.direction is not None and not any(targets.direction):
        raise document.fault("must not be zero", "targets", "direction")
    if targets.direction_tolerance_deg is not None and targets.direction is None:
        raise document.fault("goes with direction", "targets", "direction_tolerance_deg")
