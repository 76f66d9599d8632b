"""What a scenario file may say, and its joint values, files and anatomy in SI units."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from ctrplan.base.arrays import Array, read_only
from ctrplan.base.units import MOST_TURNS_DEG
from ctrplan.drive.drive import Joint
from ctrplan.files.chosen_table import chosen
from ctrplan.planning.planner_settings import PlannerSettings
from ctrplan.planning.scenario import Cost, Margins
from ctrplan.robot.nesting import nesting_violation
from ctrplan.robot.robot import Robot
from ctrplan.storage.number_ranges import Angle, Length, Name, Point, Tolerance, Vector, Weight
from ctrplan.storage.toml_document import Document, Step
from ctrplan.storage.toml_table import Table

LIMIT_TOLERANCE = 1e-9  # rad or m

Share = Annotated[float, Meta(ge=-2, le=2)]  # of a quaternion


class BaseEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[base]: the robot frame in the anatomy's frame; without any of three ways to turn it, it is not turned."""

    position_mm: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: tuple[Share, Share, Share, Share] | None = None
    direction: Vector | None = None  # of the robot's z axis, which it gets to by the shortest rotation
    look_at: Point | None = None  # mm, a point that the z axis goes through
    roll_deg: Angle | None = None  # about the z axis, before that
    position_sigma_mm: Annotated[float, Meta(ge=0, le=1000)] = 0.0  # standard deviation of each coordinate
    rotation_sigma_deg: Annotated[float, Meta(ge=0, le=180)] = 0.0  # of a small rotation about each axis


class GoalEntry(Struct, forbid_unknown_fields=True):
    """[goal] or one [[target]]: joints, or a tip position or a line for the tip in the anatomy's frame."""

    name: Name | None = None
    joints: dict[str, Any] | None = None
    tip_mm: Point | None = None
    line_mm: Annotated[list[Point], Meta(min_length=2, max_length=1000)] | None = None
    tolerance_mm: Tolerance = 1.0
    direction: Vector | None = None
    direction_tolerance_deg: Annotated[float, Meta(gt=0, le=180)] | None = None


class MarginsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[margins]."""

    stability: Annotated[float, Meta(ge=0, le=1000)] = Margins.stability
    max_strain: Annotated[float, Meta(gt=0, le=1)] = Margins.max_strain


class CostEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[cost]: weights of a cost in mm."""

    path: Weight = Cost.path
    mm_per_rad: Annotated[float, Meta(ge=1e-3, le=1e5)] = Cost.mm_per_rad
    error_along: Weight = Cost.error_along
    error_goal: Weight = Cost.error_goal
    max_error_goal_mm: Length | None = None
    stop: Weight = Cost.stop


class ScenarioEntry(Struct, forbid_unknown_fields=True):
    """A scenario file."""

    robot: str
    start: dict[str, Any]
    goal: GoalEntry | None = None
    target: list[GoalEntry] = []
    name: Name | None = None
    frame: Literal["RAS", "LPS"] | None = None  # of the patient, in which the scenario's places are said
    base: BaseEntry = BaseEntry()
    anatomy: list[dict[str, Any]] = []  # of the kind that each names, see scenario_anatomy
    fixture: list[dict[str, Any]] = []  # bodies at the base, see scenario_anatomy
    margins: MarginsEntry = MarginsEntry()
    cost: CostEntry = CostEntry()
    planner: dict[str, Any] = {}  # of the planner that it names, see planner_settings


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
    if not abs(value) <= MOST_TURNS_DEG:  # also of rotations without limits
        rule = f"must be from {-MOST_TURNS_DEG:g} to {MOST_TURNS_DEG:g} {joint.unit}"
        raise document.fault(rule, *path, joint.name, unit=joint.unit)
    q = float(value) * joint.si_per_unit
    if not joint.lower - LIMIT_TOLERANCE <= q <= joint.upper + LIMIT_TOLERANCE:
        lower, upper = joint.lower / joint.si_per_unit, joint.upper / joint.si_per_unit
        rule = f"must be within the joint's limits, {lower:.9g} to {upper:.9g} {joint.unit}"
        raise document.fault(rule, *path, joint.name, unit=joint.unit)
    return q


def planner_settings(table: Table) -> PlannerSettings:
    """[planner]. Raises InputError for a planner that there is not, and for settings that are not its own."""
    from ctrplan.planning.planner_settings import CATALOGUE, DEFAULT

    return chosen(table, "name", CATALOGUE, PlannerSettings, DEFAULT)
