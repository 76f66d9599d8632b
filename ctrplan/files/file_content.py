"""What robot and scenario files say of robots and scenarios that were made or changed in code.

Numbers are in the files' units, and such that reading them gives the same ones back. Checks of what is made in code
read this content as a file is read, so that both are refused in the same sentence.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import tomli_w
from msgspec import to_builtins

from ctrplan.anatomy.fixture import Fixture
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.base.arrays import MILLIMETRE, MM_DIGITS, MM_PER_M, Array
from ctrplan.drive.drive import Drive, ExecutionTolerance, Joint
from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.files.scenario_file import WAYS, checked_in_code, scenario_from_dict
from ctrplan.mechanics.tube import Contact, Loads, Tube, TubeSection
from ctrplan.robot.robot import Robot, StatedIntervals, file_key
from ctrplan.scenario.scenario import Cost, Goal, Scenario
from ctrplan.storage.toml_document import Document, toml_text

if TYPE_CHECKING:
    from ctrplan.planning.base_pose import BaseFrame, BasePose

OF_BODIES = ("robot", "anatomy", "fixture", "frame")  # keys of what a scenario is made with, and where it lies
DIGITS_TRIED = (6, 9, 12, 15, 16, 17)
ULPS_TRIED = 8  # to either side, where no number of digits is read as the same value


def to_toml(given: Robot | Scenario) -> str:
    """The text of a file that is read as the robot or the scenario. Raises InputError for what no file says."""
    content = robot_content(given) if isinstance(given, Robot) else scenario_content(given)
    return tomli_w.dumps(content)


@overload
def as_read(given: Robot, overrides: Sequence[str] | None = None) -> Robot: ...
@overload
def as_read(given: Scenario, overrides: Sequence[str] | None = None) -> Scenario: ...
def as_read(given: Robot | Scenario, overrides: Sequence[str] | None = None) -> Robot | Scenario:
    """A robot or scenario as it is read from a file of its content, after `overrides` of keys. Raises InputError.

    Without overrides, what no file says (loads, bodies of arrays) is left out of the content. A scenario's robot and
    bodies stay as they are where no override is of them.
    """
    if overrides is None:
        try:
            return _as_read(given, None)
        except InputError as fault:
            raise _in_code(fault) from None
    return _as_read(given, overrides)


def _in_code(fault: InputError) -> InputError:
    """A file's refusal of what was made in code: a length beyond a metre was most likely given in millimetres."""
    value = fault.value
    if fault.unit != "mm" or not isinstance(value, (int, float)) or not MM_PER_M < abs(value) < math.inf:
        return fault
    rule = f"{fault.rule}; lengths in code are in metres: is {value / MM_PER_M:g} in millimetres?"
    return InputError(rule, file=fault.file, key=fault.key, value=value, unit=fault.unit)


def _as_read(given: Robot | Scenario, overrides: Sequence[str] | None) -> Robot | Scenario:
    complete = overrides is not None
    if isinstance(given, Robot):
        return robot_from_dict(robot_content(given, complete), file=given.path, overrides=overrides or ())
    if complete and any(text.lstrip().startswith(OF_BODIES) for text in overrides or ()):
        whole = scenario_content(given)
        read = scenario_from_dict(whole, file=given.path, overrides=overrides or (), allow_outside=True)
    else:
        read = checked_in_code(scenario_content(given, complete, bodies=False), given, overrides or ())
    return replace(read, terms=given.terms) if complete and given.terms else read


def robot_content(robot: Robot, complete: bool = True) -> dict[str, Any]:
    """What a robot file says of the robot. Raises InputError, if `complete`, for what no file says."""
    plain = robot.ideal or robot
    if complete:
        _refuse_unsaid(plain)
    content: dict[str, Any] = {
        "name": robot.name,
        "model_error_mm": _mm(plain.model_error_m),
        "friction_memory": robot.friction_memory,
        "tube": [_tube(tube) for tube in plain.tubes],
        "contact": [_contact(contact) for contact in plain.contacts],
    }
    if plain.drive is not None:
        content |= _drive(plain.drive)
    if robot.measurement is not None:
        noise = robot.measurement
        content["measurement"] = _without_none(
            position_sigma_mm=_mm(noise.position_sigma_m), tangent_sigma_deg=_deg(noise.tangent_sigma_rad)
        )
    content["marker"] = [
        _without_none(
            name=marker.name,
            tube=marker.tube,
            **{f"from_{marker.end}_mm": _mm(marker.distance_m)},
            position_sigma_mm=_mm(marker.position_sigma_m),
        )
        for marker in robot.markers
    ]
    content["uncertainty"] = _intervals(robot.intervals)
    content |= {"effects": copy.deepcopy(dict(robot.effects)), "provenance": copy.deepcopy(dict(robot.provenance))}
    return {key: value for key, value in content.items() if value not in ([], {})}


UNSAID = ("ovality", "ovality_axis_rad", "softening_strain", "softening_fraction", "shaft_compliance_rad_per_Nm")


def _refuse_unsaid(robot: Robot) -> None:
    rule = "stands in no robot file by itself: say it by the robot's effects"
    default = {each.name: each.default for each in fields(Tube)}
    for i, tube in enumerate(robot.tubes, start=1):
        for name in (name for name in UNSAID if getattr(tube, name) != default[name]):
            raise InputError(rule, key=f"tube.{i}.{name}", value=getattr(tube, name))
        for k, section in enumerate(tube.sections, start=1):
            if section.gradient:
                raise InputError(rule, key=f"tube.{i}.section.{k}.gradient", value=section.gradient)
            if section.bent:
                raise InputError(rule, key=f"tube.{i}.section.{k}.bent", value=section.bent)
    if robot.loads != Loads():
        raise InputError(rule, key="loads")
    if robot.drive is not None and (robot.drive.terms or robot.drive.play is not None or robot.drive.late_s):
        raise InputError(rule, key="drive")


def _tube(tube: Tube) -> dict[str, Any]:
    return {
        "outer_diameter_mm": _mm(tube.outer_diameter_m),
        "inner_diameter_mm": _mm(tube.inner_diameter_m),
        "bending_stiffness_Nm2": tube.bending_stiffness_Nm2,
        "poisson_ratio": tube.poisson_ratio,
        "collar_length_mm": _mm(tube.collar_length_m),
        "max_strain": tube.max_strain,
        "density_kg_m3": tube.density_kg_m3,
        "retractable": tube.retractable,
        "section": [_section(section) for section in tube.sections],
    }


def _section(section: TubeSection) -> dict[str, Any]:
    curvatures = {name: getattr(section, name) for name in ("curvature_x_per_m", "curvature_y_per_m")}
    return {"length_mm": _mm(section.length_m), **curvatures}


def _contact(contact: Contact) -> dict[str, Any]:
    low, high = contact.friction_coefficient
    return _without_none(
        friction_coefficient=low if low == high else [low, high], clearance_mm=_mm(contact.clearance_m)
    )


def _drive(drive: Drive) -> dict[str, Any]:
    home = {
        "theta_deg": [_deg(angle) for angle in drive.home_theta_rad.tolist()],
        "l_mm": [_mm(length) for length in drive.home_l_m.tolist()],
    }
    content: dict[str, Any] = {"home": home, "joint": [_joint(joint) for joint in drive.joints]}
    if drive.execution != ExecutionTolerance():
        tolerance = drive.execution
        content["execution"] = {
            "rotation_deg": _deg(tolerance.rotation_rad),
            "translation_mm": _mm(tolerance.translation_m),
        }
    return content


def _joint(joint: Joint) -> dict[str, Any]:
    unit = joint.unit
    content: dict[str, Any] = {
        "name": joint.name,
        "moves": {"theta" if joint.kind == "rotation" else "l": joint.moves.tolist()},
    }
    limits = {f"min_{unit}": joint.lower, f"max_{unit}": joint.upper}
    rates = {
        f"max_velocity_{unit}_s": joint.max_velocity,
        f"max_acceleration_{unit}_s2": joint.max_acceleration,
        f"max_jerk_{unit}_s3": joint.max_jerk,
    }
    for key, value in (limits | rates).items():
        if math.isfinite(value):
            content[key] = _in(joint.si_per_unit, value)
    return content


def _intervals(stated: StatedIntervals) -> dict[str, Any]:
    ci95 = {}
    for name, ends in stated.ci95.items():
        key, in_unit = file_key(name, 1.0)
        ci95[key] = [_in(1 / in_unit, end) for end in ends]
    names = [name if name.startswith("effects.") else file_key(name, 1.0)[0] for name in stated.correlated]
    content: dict[str, Any] = {"ci95": ci95} if ci95 else {}
    if stated.correlation is not None:
        content |= {"correlated": names, "correlation": stated.correlation.tolist()}
    return content


def scenario_content(scenario: Scenario, complete: bool = True, *, bodies: bool = True) -> dict[str, Any]:
    """What a scenario file says of the scenario.

    Raises InputError, if `complete`, for what no file says; of robot and bodies if that is asked of `bodies`, too.
    """
    drive, folder = scenario.robot.drive, Path(scenario.path or ".").parent
    friction = scenario.start_friction
    if friction == "observed":
        if complete:
            raise InputError("is what an observer knows, which no file says", key="start.friction", value=friction)
        friction = "unknown"
    if scenario.start_turns == "followed" and complete:
        raise InputError("is the way to the start, which no file says", key="start.turns", value="followed")
    turns = "unknown" if scenario.start_turns == "followed" else scenario.start_turns
    start = {"friction": friction, "turns": turns, **_joints(drive, scenario.start, "start")}
    content: dict[str, Any] = {
        "name": scenario.name,
        "robot": robot_content(scenario.robot, bodies),
        "start": start,
        "base": _base(scenario),
        "anatomy": [_body(part, folder, bodies, f"anatomy.{k}") for k, part in enumerate(scenario.anatomy, 1)],
        "fixture": [_body(body, folder, bodies, f"fixture.{k}") for k, body in enumerate(scenario.fixtures, 1)],
        "margins": {"stability": scenario.margins.stability, "max_strain": scenario.margins.max_strain},
        "cost": _cost(scenario.cost),
        "planner": _without_none(**to_builtins(scenario.planner)),
    }
    goals = [_goal(drive, goal) for goal in _without_beginnings(scenario.targets)]
    content |= {"goal": goals[0]} if len(goals) == 1 and scenario.goal.table == "goal" else {"target": goals}
    if scenario.frame is not None:
        content["frame"] = scenario.frame
    return {key: value for key, value in content.items() if value not in ([], {})}


def _joints(drive: Drive, q: Array, key: str) -> dict[str, float]:
    if q.shape != (len(drive.joints),):
        raise InputError(f"must have one value per joint, shape ({len(drive.joints)},), not {q.shape}", key=key)
    return {joint.name: _in(joint.si_per_unit, x) for joint, x in zip(drive.joints, q.tolist(), strict=True)}


def _base(scenario: Scenario) -> dict[str, Any]:
    content: dict[str, Any] = {"position_mm": _point(scenario.base_position_m)}
    if not np.array_equal(scenario.base_R, np.eye(3)):
        content["rotation_matrix"] = scenario.base_R.tolist()
    known = scenario.registration
    if not known.is_exact:
        content["position_sigma_mm"] = _mm(known.position_sigma_m)
        content["rotation_sigma_deg"] = _deg(known.rotation_sigma_rad)
    return content


def _without_beginnings(goals: Sequence[Goal]) -> Iterable[Goal]:
    """The goals without those that are the first points of lines, which a file does not name."""
    for goal, after in zip(goals, [*goals[1:], None], strict=True):
        if after is None or after.line_m is None or not goal.tip_key.startswith("line_mm"):
            yield goal


def _goal(drive: Drive, goal: Goal) -> dict[str, Any]:
    content: dict[str, Any] = {"name": goal.name} if goal.name else {}
    if goal.joints is not None:
        content["joints"] = _joints(drive, goal.joints, f"{goal.table}.joints")
    if goal.line_m is not None:
        content["line_mm"] = [_point(point) for point in goal.line_m]
    elif goal.tip_m is not None:
        content["tip_mm"] = _point(goal.tip_m)
    content["tolerance_mm"] = _mm(goal.tolerance_m)
    if goal.direction is not None:
        content["direction"] = goal.direction.tolist()
    return content | _without_none(direction_tolerance_deg=_deg(goal.direction_tolerance_rad))


def _cost(cost: Cost) -> dict[str, Any]:
    weights = {each.name: getattr(cost, each.name) for each in fields(cost) if each.name != "max_error_goal_m"}
    return weights | _without_none(max_error_goal_mm=_mm(cost.max_error_goal_m))


def _body(body: AnatomyPart | Fixture, folder: Path, complete: bool, key: str) -> dict[str, Any]:
    """What a file says of an anatomy's part or a fixture, its files named from a folder."""
    try:
        content = (
            dict(body.source_table) if body.source_table is not None else {"kind": body.shape.kind, **body.shape.keys()}
        )
    except InputError as fault:
        if complete:
            raise InputError(fault.rule, key=key) from None
        content = {"kind": body.shape.kind}
    if "file" in content:
        content["file"] = _from(folder, content["file"])
    if "files" in content:
        content["files"] = [_from(folder, file) for file in content["files"]]
    off = body.shape.surface_error_m
    content["margin_mm"] = _said(
        body.margin_m, lambda given: given / MM_PER_M + off, max(0.0, (body.margin_m - off) * MM_PER_M)
    )
    if isinstance(body, AnatomyPart):
        content["role"] = body.role
    else:
        content |= {"name": body.name, "stays_inside": body.stays_inside}
    return content


def _from(folder: Path, file: str) -> str:
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # another drive of Windows
        return Path(file).absolute().as_posix()


def _said(value: float, read: Callable[[float], float], guess: float) -> float:
    """The shortest number that `read` makes `value` of, as near to `guess` as there is one; else the guess."""
    for digits in DIGITS_TRIED:
        if read(short := float(f"{guess:.{digits}g}")) == value:
            return short
    for way in (-math.inf, math.inf):
        near = guess
        for _ in range(ULPS_TRIED):
            near = math.nextafter(near, way)
            if read(near) == value:
                return near
    return guess


def _in(si: float, value: float) -> float:
    """A value in a unit whose SI value is `si`."""
    return _said(value, lambda given: given * si, value / si)


def _mm(metres: float | None) -> float | None:
    return None if metres is None else _in(MILLIMETRE, metres)


def _deg(radians: float | None) -> float | None:
    return None if radians is None else _said(radians, math.radians, math.degrees(radians))


def _point(metres: Array) -> list[float]:
    return [_in(MILLIMETRE, x) for x in metres.tolist()]


def _without_none(**table: Any) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value is not None}


TURNS = (*WAYS, "roll_deg")


def placed_scenario(document: Document, pose: BasePose, file: Path) -> str:
    """The content of `document`, a scenario's, as a file at `file`; read back, it has exactly the pose."""
    content = copy.deepcopy(document.content) if pose.is_own else content_at(document.content, pose)
    here = Path(document.file or ".").parent
    if here.resolve() != file.parent.resolve():
        _name_files_from(content, here, file.parent)
    direction = ", ".join(f"{x:.4f}" for x in pose.direction)
    return f"# Base pose proposed by `ctrplan place`; it looks along [{direction}].\n{toml_text(content)}"


def content_at(content: dict[str, Any], pose: BasePose | BaseFrame) -> dict[str, Any]:
    """A scenario's content with its robot at a pose, and with what was said of how well the base is known."""
    base = {**_pose(pose), **_without_turns(content.get("base", {}))}
    return {**copy.deepcopy(content), "base": base}


def base_key(scenario: Scenario, pose: BasePose) -> str:
    """An override that puts a scenario's robot to a pose; how well the base is known stays as it was said."""
    stated, degrees = scenario.registration, math.degrees(scenario.registration.rotation_sigma_rad)
    sigmas = {"position_sigma_mm": stated.position_sigma_m * MM_PER_M, "rotation_sigma_deg": degrees}
    content = {**_pose(pose), **{key: value for key, value in sigmas.items() if value}}
    return f"base={{{toml_text(content).strip().replace(chr(10), ', ')}}}"


def names_files_outside(document: Document, file: Path) -> bool:
    """Whether the file at `file` would name some that lie outside of its folder."""
    inside, here = file.parent.resolve(), Path(document.file or ".").parent
    return any(not (here / table[key]).resolve().is_relative_to(inside) for table, key in _files(document.content))


def _pose(pose: BasePose | BaseFrame) -> dict[str, Any]:
    from ctrplan.planning.base_pose import DIGITS, BaseFrame  # planning, which reading needs nothing of

    quaternion = BaseFrame(pose.position_m, pose.R).quaternion_wxyz
    position_mm = np.round(pose.position_m * MM_PER_M, MM_DIGITS) + 0.0  # no -0
    return {"position_mm": position_mm.tolist(), "quaternion_wxyz": (np.round(quaternion, DIGITS) + 0.0).tolist()}


def _without_turns(base: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in base.items() if key not in (*TURNS, "position_mm")}


def _name_files_from(content: dict[str, Any], old: Path, new: Path) -> None:
    for table, key in _files(content):
        if not os.path.isabs(table[key]):
            table[key] = Path(os.path.relpath(old / table[key], new)).as_posix()


def _files(content: dict[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Tables and keys that name a file."""
    parts = [*content.get("anatomy", []), *content.get("fixture", [])]
    named = [(part, "file") for part in parts if "file" in part]
    return named if isinstance(content.get("robot"), Mapping) else [(content, "robot"), *named]
