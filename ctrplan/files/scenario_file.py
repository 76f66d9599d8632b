"""Scenario files (TOML) -> Scenario; a robot file stands in free space; scenarios with their robot placed elsewhere."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.structure import images_kept
from ctrplan.base.arguments import or_meant
from ctrplan.base.arrays import MOST_TURNS_DEG, NORM_TOLERANCE, Array, read_only, shortest_rotation, unit
from ctrplan.drive.drive import JOINT_ROUNDING, Joint
from ctrplan.errors import InputError
from ctrplan.files.robot_file import ROBOT_PREFIX, load_robot, of_robot, robot_from_dict
from ctrplan.files.scenario_anatomy import anatomy_notes, anatomy_part, fixture, refuse_targets_outside_images
from ctrplan.robot.magnitudes import summarised
from ctrplan.robot.robot import Robot, nesting_violation
from ctrplan.scenario import sizes
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import (
    Cost,
    Goal,
    Margins,
    PlannerSettings,
    Registration,
    Scenario,
    StartFriction,
    StartTurns,
    rotation_matrix,
)
from ctrplan.storage.toml_document import (
    Angle,
    Document,
    Length,
    Name,
    Point,
    Step,
    Tolerance,
    TomlTable,
    Vector,
    Weight,
    checked_overrides,
    chosen,
    file_inside,
    in_si,
    metres,
    read_document,
)
from ctrplan.storage.toml_faults import rule_of_options

if TYPE_CHECKING:
    pass


Share = Annotated[float, Meta(ge=-2, le=2)]  # of a quaternion or a rotation
Row = tuple[Share, Share, Share]


class BaseEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[base]: the robot frame in the anatomy's frame; without any of four ways to turn it, it is not turned."""

    position_mm: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: tuple[Share, Share, Share, Share] | None = None
    direction: Vector | None = None  # of the robot's z axis, which it gets to by the shortest rotation
    look_at: Point | None = None  # mm, a point that the z axis goes through
    rotation_matrix: tuple[Row, Row, Row] | None = None  # rows, from the robot's frame to the anatomy's
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

    robot: str | dict[str, Any]  # a file, or what stands in one
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
            rule = f"unknown joint, the robot has {', '.join(robot.drive.names)}{or_meant(name, robot.drive.names)}"
            raise document.fault(rule, *path, name)
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
    if not joint.lower - JOINT_ROUNDING <= q <= joint.upper + JOINT_ROUNDING:
        lower, upper = joint.lower / joint.si_per_unit, joint.upper / joint.si_per_unit
        rule = f"must be within the joint's limits, {lower:.9g} to {upper:.9g} {joint.unit}"
        raise document.fault(rule, *path, joint.name, unit=joint.unit)
    return q


def planner_settings(table: TomlTable) -> PlannerSettings:
    """[planner]. Raises InputError for a planner that there is not, and for settings that are not its own."""
    from ctrplan.scenario.scenario import CATALOGUE, DEFAULT

    return chosen(table, "name", CATALOGUE, PlannerSettings, DEFAULT)


WAYS = ("quaternion_wxyz", "direction", "look_at", "rotation_matrix")


def base_rotation(base: BaseEntry, document: Document) -> Array:
    """(3, 3) from the robot's frame to the anatomy's. Raises InputError for two ways of saying it, and none."""
    from scipy.spatial.transform import Rotation  # slow to import

    given = [way for way in WAYS if getattr(base, way) is not None]
    if len(given) > 1:
        raise document.fault(f"must be turned in one way, not by {' and '.join(given)}", "base")
    if base.roll_deg is not None and given not in (["direction"], ["look_at"]):
        raise document.fault("goes with direction or look_at", "base", "roll_deg")
    if base.rotation_matrix is not None:
        try:
            return rotation_matrix("base.rotation_matrix", base.rotation_matrix)
        except InputError as fault:
            raise document.fault(fault.rule, "base", "rotation_matrix") from None
    if given in ([], ["quaternion_wxyz"]):
        return _turned(base.quaternion_wxyz or (1.0, 0.0, 0.0, 0.0), document)
    roll = Rotation.from_euler("z", base.roll_deg or 0.0, degrees=True).as_matrix()
    return read_only(shortest_rotation(_direction(base, document)) @ roll)


def _turned(wxyz: tuple[float, float, float, float], document: Document) -> Array:
    from scipy.spatial.transform import Rotation  # slow to import

    w, x, y, z = wxyz
    norm = math.hypot(w, x, y, z)
    if not abs(norm - 1) <= NORM_TOLERANCE:
        rule = f"must have norm 1 within {NORM_TOLERANCE}, has {norm:g}"
        raise document.fault(rule, "base", "quaternion_wxyz")
    return read_only(Rotation.from_quat([x, y, z, w]).as_matrix())


def _direction(base: BaseEntry, document: Document) -> Array:
    """(3,) of any length."""
    if base.direction is not None:
        if not any(base.direction):
            raise document.fault("must not be zero", "base", "direction")
        return np.array(base.direction)
    away: Array = np.subtract(base.look_at or base.position_mm, base.position_mm)
    if not away.any():
        raise document.fault("must not be the base's own position_mm", "base", "look_at")
    return away


FRICTION, WHOLE_TURNS = "friction", "turns"  # keys of [start] that are no joints


def load_scenario(
    path: str | os.PathLike[str], overrides: Sequence[str] = (), *, allow_outside: bool = False
) -> Scenario:
    """The scenario of a TOML file after `overrides`; those that start with "robot." go to the robot's file.

    Files it names must lie in the scenario file's folder or below unless `allow_outside`. Raises InputError, one
    sentence with file, key, value and rule, for anything malformed or contradictory.
    """
    own, for_robot = _by_file(overrides)
    return _build(read_document(path, own), for_robot, allow_outside)


def scenario_from_dict(
    content: Mapping[str, Any],
    *,
    file: str | None = None,
    overrides: Sequence[str] = (),
    allow_outside: bool = False,
) -> Scenario:
    """The scenario of a scenario file's content; as `load_scenario`, with files relative to the folder of `file`."""
    own, for_robot = _by_file(overrides)
    return _build(Document.of(content, "scenario", file).with_overrides(own), for_robot, allow_outside)


def _by_file(overrides: Sequence[str]) -> tuple[list[str], list[str]]:
    """Overrides of the scenario's keys, and those of the robot's keys without their prefix."""
    stripped = [override.lstrip() for override in checked_overrides(overrides)]
    own = [override for override in stripped if not override.startswith(ROBOT_PREFIX)]
    return own, [override[len(ROBOT_PREFIX) :] for override in stripped if override.startswith(ROBOT_PREFIX)]


def checked_in_code(content: Mapping[str, Any], made: Scenario, overrides: Sequence[str] = ()) -> Scenario:
    """The scenario of `content`, which a scenario made in code would have as a file, with its robot and bodies.

    Overrides are of other keys than theirs. Raises InputError, as `load_scenario`.
    """
    document = Document.of(content, "scenario", made.path if overrides else None)
    return _build(document.with_overrides(_by_file(overrides)[0]), (), True, made)


def _build(document: Document, for_robot: Sequence[str], allow_outside: bool, made: Scenario | None = None) -> Scenario:
    entry = document.to(ScenarioEntry)
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    if made is not None:
        robot = made.robot
    elif isinstance(entry.robot, str):
        robot = load_robot(file_inside(entry.robot, document, allow_outside, "robot"), for_robot)
    else:
        robot = robot_from_dict(entry.robot, file=f"{document.file or 'scenario'}, [robot]", overrides=for_robot)
    goals = _goals(entry, robot, document)
    tables = [TomlTable(document, ("anatomy", k), allow_outside) for k in range(len(entry.anatomy))]
    with images_kept():
        anatomy = made.anatomy if made is not None else tuple(map(anatomy_part, tables))
    refuse_targets_outside_images(anatomy, goals, document)
    base_m, base_R = read_only(np.multiply(entry.base.position_mm, 1e-3)), base_rotation(entry.base, document)
    doubts = _refuse_wrong_units((robot, goals, base_m, anatomy), document, in_code=made is not None)
    fixtures = (
        ()
        if made is not None
        else tuple(fixture(TomlTable(document, ("fixture", k), allow_outside)) for k in range(len(entry.fixture)))
    )
    return Scenario(
        name=entry.name or (Path(document.file).stem if document.file else "scenario"),
        robot=robot,
        base_position_m=base_m,
        base_R=base_R,
        registration=Registration(entry.base.position_sigma_mm * 1e-3, math.radians(entry.base.rotation_sigma_deg)),
        start=joint_values(
            {k: v for k, v in entry.start.items() if k not in (FRICTION, WHOLE_TURNS)}, robot, document, "start"
        ),
        start_friction=_start_friction(entry, document),
        start_turns=_start_turns(entry, document),
        goal=goals[-1],
        via=tuple(goals[:-1]),
        anatomy=anatomy,
        frame=entry.frame,
        fixtures=made.fixtures if made is not None else fixtures,
        margins=Margins(**msgspec.structs.asdict(entry.margins)),
        cost=_cost(entry.cost),
        planner=planner_settings(TomlTable(document, ("planner",))),
        path=document.file,
        content=document.content,
        warnings=(*doubts, *robot.warnings, *anatomy_notes(anatomy), *sizes.load_notes(robot, base_R)),
    )


_Sized = tuple[Robot, Sequence[Goal], Array, Sequence[AnatomyPart]]  # the base at (3,) [m]


def _refuse_wrong_units(given: _Sized, document: Document, *, in_code: bool) -> tuple[str, ...]:
    """A sentence about what may be in another unit. Raises InputError for what surely is."""
    doubts = list(_size_doubts(given, document, in_code=in_code))
    for doubt, fault in doubts:
        if doubt.is_sure:
            raise fault
    return summarised([str(fault) for _, fault in doubts], f"ctrplan check {document.file or 'SCENARIO.toml'}")


def doubtful_sizes(scenario: Scenario) -> list[str]:
    """A sentence for each number of a scenario's file, besides its robot's, that may be in another unit."""
    document = Document(dict(scenario.content), scenario.path)
    given = scenario.robot, scenario.targets, scenario.base_position_m, scenario.anatomy
    return [str(fault) for _, fault in _size_doubts(given, document)] if scenario.content else []


def _size_doubts(
    given: _Sized, document: Document, *, in_code: bool = False
) -> Iterator[tuple[sizes.SizeDoubt, InputError]]:
    """Doubts, and what they are refused with: what was made in code in the units that it has there."""
    robot, goals, base_m, anatomy = given
    read_in = "m" if in_code else "mm"

    def fault(rule: str, *steps: Step) -> InputError:
        return in_si(document.fault(rule, *steps)) if in_code else document.fault(rule, *steps)

    aims = [goal for goal in goals if goal.tip_m is not None]
    tips = [goal.tip_m for goal in aims if goal.tip_m is not None]
    if base := sizes.base_doubt(robot, tips, base_m, read_in):
        yield base, fault(base.rule, "base", "position_mm")
    for goal, tip in zip(aims, tips, strict=True) if not base else ():
        if doubt := sizes.place_doubt(robot, tip, base_m, read_in, anatomy):
            steps = [int(step) - 1 if step.isdecimal() else step for step in f"{goal.table}.{goal.tip_key}".split(".")]
            yield doubt, fault(doubt.rule, *steps)
            break
    in_parts = list(sizes.part_doubts(robot, anatomy, tips, base_m))
    for k, doubt in in_parts or sizes.scene_doubts(robot, anatomy, tips, base_m):
        yield doubt, fault(doubt.rule, "anatomy", k, doubt.key)
    for doubt in sizes.turn_doubts(_table(content := document.content, ("base",))):
        yield doubt, fault(doubt.rule, "base", doubt.key)
    targets: list[tuple[Step, ...]] = [("target", k) for k in range(len(content.get("target", ())))]
    for place in [("start",), ("goal", "joints"), *((*target, "joints") for target in targets)]:
        for name, doubt in sizes.joint_doubts(robot, _table(content, place)):
            yield doubt, fault(doubt.rule, *place, name)
    bodies: list[tuple[Step, ...]] = [(kind, k) for kind in BODIES for k in range(len(content.get(kind, ())))]
    within = {
        (*place, key): float(_table(content, place)[key])
        for place in (("base",), ("goal",), ("cost",), *targets, *bodies)
        for key in WITHIN
        if key in _table(content, place)
    }
    for where, doubt in sizes.tolerance_doubts(robot, within, read_in):
        yield doubt, fault(doubt.rule, *where)


BODIES = ("anatomy", "fixture")
WITHIN_MM = ["tolerance_mm", "margin_mm", "radius_mm", "max_error_goal_mm", "position_sigma_mm"]
WITHIN = *WITHIN_MM, "rotation_sigma_deg", "direction_tolerance_deg"


def _table(content: Any, place: Sequence[Step]) -> dict[str, Any]:
    for step in place:
        content = (content[step] if isinstance(step, int) else content.get(step)) or {}
    return cast(dict[str, Any], content)


def _start_friction(entry: ScenarioEntry, document: Document) -> StartFriction:
    known = [name for name in get_args(StartFriction) if name != "observed"]  # which needs an observer's state
    value = entry.start.get(FRICTION, "unknown")
    if value not in known:
        raise document.fault(rule_of_options(known, FRICTION, value), "start", FRICTION)
    return cast(StartFriction, value)


def _start_turns(entry: ScenarioEntry, document: Document) -> StartTurns:
    known = [name for name in get_args(StartTurns) if name != "followed"]  # which needs the way to the start
    value = entry.start.get(WHOLE_TURNS, "unknown")
    if value not in known:
        raise document.fault(rule_of_options(known, WHOLE_TURNS, value), "start", WHOLE_TURNS)
    return cast(StartTurns, value)


def _goals(entry: ScenarioEntry, robot: Robot, document: Document) -> list[Goal]:
    if (entry.goal is None) == (not entry.target):
        what = "is missing, or [[target]] in its place" if entry.goal is None else "and [[target]] exclude each other"
        raise document.fault(what, "goal")
    if entry.goal is not None:
        return _goal(entry.goal, robot, document, "goal")
    return [goal for k, target in enumerate(entry.target) for goal in _goal(target, robot, document, "target", k)]


def _goal(entry: GoalEntry, robot: Robot, document: Document, *path: Step) -> list[Goal]:
    """The goal, and before it the beginning of its line if it has one."""
    given = [key for key in ("joints", "tip_mm", "line_mm") if getattr(entry, key) is not None]
    if len(given) != 1 and given != ["joints", "tip_mm"]:
        rule = "must have one of joints, tip_mm and line_mm"
        raise document.fault(f"{rule}; joints may have the tip_mm that they are for" if given else rule, *path)
    if entry.joints is not None and entry.direction is not None:
        raise document.fault("goes with tip_mm, not with joints", *path, "direction")
    if (entry.direction is None) != (entry.direction_tolerance_deg is None):
        missing = "direction" if entry.direction is None else "direction_tolerance_deg"
        raise document.fault("is missing, direction and direction_tolerance_deg go together", *path, missing)
    tolerance = entry.direction_tolerance_deg
    line = None if entry.line_mm is None else read_only(np.multiply(entry.line_mm, 1e-3))
    if line is not None and not np.any(np.diff(line, axis=0)):
        raise document.fault("must have a length", *path, "line_mm")
    name, tip_m = entry.name or "", None if entry.tip_mm is None else metres(entry.tip_mm)
    table = ".".join(step if isinstance(step, str) else str(step + 1) for step in path)
    goal = Goal(
        joints=None if entry.joints is None else joint_values(entry.joints, robot, document, *path, "joints"),
        tip_m=tip_m if line is None else read_only(line[-1]),
        tolerance_m=entry.tolerance_mm * 1e-3,
        direction=None if entry.direction is None else _unit_vector(entry.direction, document, *path),
        direction_tolerance_rad=None if tolerance is None else math.radians(tolerance),
        line_m=line,
        name=name,
        table=table,
    )
    if line is None:
        return [goal]
    beginning = f"{name or 'line'}, beginning"
    return [replace(goal, tip_m=read_only(line[0]), line_m=None, name=beginning, tip_key="line_mm.1"), goal]


def _unit_vector(vector: Vector, document: Document, *path: Step) -> Array:
    if not any(vector):
        raise document.fault("must not be zero", *path, "direction")
    return read_only(unit(vector))


def _cost(entry: CostEntry) -> Cost:
    limit_m = None if entry.max_error_goal_mm is None else entry.max_error_goal_mm * 1e-3
    return Cost(entry.path, entry.mm_per_rad, entry.error_along, entry.error_goal, limit_m, entry.stop)


def load_robot_or_scenario(
    path: str | os.PathLike[str], overrides: Sequence[str] = (), *, allow_outside: bool = False
) -> Scenario:
    """The scenario of a file, or the bare scenario of a robot file: what has tubes is a robot. Raises InputError."""
    document = read_document(path)
    if "tube" not in document.content:
        return load_scenario(path, overrides, allow_outside=allow_outside)
    return bare_scenario(robot_from_dict(document.with_overrides(of_robot(overrides)).content, file=document.file))
