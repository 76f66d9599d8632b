"""What a scenario file may say, and its joint values, files and anatomy in SI units."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from ctrplan.base.arrays import Array, read_only
from ctrplan.drive.drive import Joint
from ctrplan.files.drive_file import Name, Positive
from ctrplan.files.robot_entries import NotNegative
from ctrplan.robot.nesting import nesting_violation
from ctrplan.robot.robot import Robot
from ctrplan.storage.toml_document import Document, Step

if TYPE_CHECKING:
    from ctrplan.anatomy.clearance_grid import AnatomyPart

Vector = tuple[float, float, float]
Coordinate = Annotated[float, Meta(ge=-1e5, le=1e5)]  # mm; beyond it the value is in another unit
Point = tuple[Coordinate, Coordinate, Coordinate]
SHAPE_KEYS = {
    "sphere": ("center_mm", "radius_mm"),
    "capsule": ("from_mm", "to_mm", "radius_mm"),
    "mesh": ("file", "unit"),
}
LIMIT_TOLERANCE = 1e-9  # rad or m


class BaseEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[base]: the robot frame in the anatomy's frame."""

    position_mm: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


class GoalEntry(Struct, forbid_unknown_fields=True):
    """[goal] or one [[target]]: joints, or a tip position or a line for the tip in the anatomy's frame."""

    name: Name | None = None
    joints: dict[str, Any] | None = None
    tip_mm: Point | None = None
    line_mm: Annotated[list[Point], Meta(min_length=2, max_length=1000)] | None = None
    tolerance_mm: Positive = 1.0
    direction: Vector | None = None
    direction_tolerance_deg: Annotated[float, Meta(gt=0, le=180)] | None = None


class AnatomyEntry(Struct, forbid_unknown_fields=True):
    """[[anatomy]]: one sphere, capsule or mesh."""

    kind: Literal["sphere", "capsule", "mesh"]
    role: Literal["avoid", "inside"] = "avoid"
    margin_mm: NotNegative = 0.0
    center_mm: Point | None = None
    radius_mm: Positive | None = None
    from_mm: Point | None = None
    to_mm: Point | None = None
    file: str | None = None
    unit: Literal["mm", "cm", "m"] | None = None


class MarginsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[margins]."""

    stability: NotNegative = 0.1
    max_strain: Annotated[float, Meta(gt=0, le=1)] = 0.08


class CostEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[cost]: weights of a cost in mm."""

    path: NotNegative = 1.0
    mm_per_rad: Positive = 20.0
    error_along: NotNegative = 1.0
    error_goal: NotNegative = 10.0
    max_error_goal_mm: Positive | None = None
    stop: NotNegative = 2.0


class PlannerEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[planner]."""

    name: Literal["BIT*", "RRT*", "RRTConnect"] = "BIT*"
    time_s: Annotated[float, Meta(gt=0, le=3600)] = 5.0
    settle: Literal["none", "oscillate"] = "none"


class ScenarioEntry(Struct, forbid_unknown_fields=True):
    """A scenario file."""

    robot: str
    start: dict[str, Any]
    goal: GoalEntry | None = None
    target: list[GoalEntry] = []
    name: Name | None = None
    base: BaseEntry = BaseEntry()
    anatomy: list[AnatomyEntry] = []
    margins: MarginsEntry = MarginsEntry()
    cost: CostEntry = CostEntry()
    planner: PlannerEntry = PlannerEntry()


def joint_values(table: dict[str, Any], robot: Robot, document: Document, *path: Step) -> Array:
    """(m,) rad or m from a table of joint names in deg or mm; `path` is the table's own key.

    Raises InputError for an unknown or missing joint, a value beyond its limits, and tubes that don't nest.
    """
    joints = robot.drive.joints
    for name in table:
        if name not in robot.drive.names:
            raise document.fault(f"unknown joint, the robot has {', '.join(robot.drive.names)}", *path, name)
    q = read_only([_joint_value(table, joint, document, *path) for joint in joints])
    if violation := nesting_violation(robot, *robot.drive.collars(q)):
        raise document.fault(violation, *path)
    return q


def _joint_value(table: dict[str, Any], joint: Joint, document: Document, *path: Step) -> float:
    if joint.name not in table:
        raise document.fault(f"is missing, every joint needs a value (in {joint.unit})", *path, joint.name)
    value = table[joint.name]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise document.fault(f"must be a number (in {joint.unit})", *path, joint.name)
    q = float(value) * joint.si_per_unit
    if not joint.lower - LIMIT_TOLERANCE <= q <= joint.upper + LIMIT_TOLERANCE:
        lower, upper = joint.lower / joint.si_per_unit, joint.upper / joint.si_per_unit
        rule = f"must be within the joint's limits, {lower:.9g} to {upper:.9g} {joint.unit}"
        raise document.fault(rule, *path, joint.name, unit=joint.unit)
    return q


def file_inside(name: str, document: Document, allow_outside: bool, *path: Step) -> Path:
    """The file that key `path` names, relative to the document's folder.

    Raises InputError when it lies outside that folder, unless allowed, or does not exist.
    """
    folder = Path(document.file or ".").parent
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
        exists = (folder / name).is_file()
    except (OSError, ValueError, RuntimeError):  # a NUL in the name, a loop of links, a closed folder
        inside, exists = True, False
    if not (inside or allow_outside):
        raise document.fault("must lie in the folder of this file or below", *path)
    if not exists:
        raise document.fault("is not a file that exists", *path)
    return folder / name


def anatomy_part(entry: AnatomyEntry, k: int, document: Document, allow_outside: bool) -> AnatomyPart:
    """Entry `k` (from 0) of the anatomy. Raises InputError for keys that its kind lacks or does not have."""
    from ctrplan.anatomy.clearance_grid import AnatomyPart, load_mesh  # slow to import; many scenarios need no meshes

    needed = SHAPE_KEYS[entry.kind]
    for key in sorted({key for keys in SHAPE_KEYS.values() for key in keys}):
        if key in needed and getattr(entry, key) is None:
            raise document.fault(f"is missing, a {entry.kind} needs {', '.join(needed)}", "anatomy", k, key)
        if key not in needed and getattr(entry, key) is not None:
            raise document.fault(f"does not go with kind = '{entry.kind}'", "anatomy", k, key)
    vertices, faces, file = None, None, None
    if entry.file is not None and entry.unit is not None:
        file = str(file_inside(entry.file, document, allow_outside, "anatomy", k, "file"))
        vertices, faces = load_mesh(file, entry.unit, file=document.file, key=f"anatomy.{k + 1}.file")
    return AnatomyPart(
        kind=entry.kind,
        role=entry.role,
        margin_m=entry.margin_mm * 1e-3,
        center_m=metres(entry.center_mm),
        radius_m=None if entry.radius_mm is None else entry.radius_mm * 1e-3,
        from_m=metres(entry.from_mm),
        to_m=metres(entry.to_mm),
        vertices_m=vertices,
        faces=faces,
        file=file,
    )


def metres(vector_mm: Point | None) -> Array | None:
    """(3,) [m] of a vector in mm."""
    return None if vector_mm is None else read_only(np.multiply(vector_mm, 1e-3))
