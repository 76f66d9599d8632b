"""Scenario files (TOML) -> Scenario."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from ctrplan.anatomy.images.kept import images_kept
from ctrplan.base.arrays import Array, read_only
from ctrplan.base.directions import unit
from ctrplan.files.base_rotation import base_rotation
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_anatomy import anatomy_notes, anatomy_part, fixture, refuse_targets_outside_images
from ctrplan.files.scenario_entries import (
    CostEntry,
    GoalEntry,
    ScenarioEntry,
    joint_values,
    planner_settings,
)
from ctrplan.planning.scenario import Cost, Goal, Margins, Registration, Scenario, StartFriction
from ctrplan.robot.robot import Robot
from ctrplan.storage.number_ranges import Vector, metres
from ctrplan.storage.toml_document import Document, Step, checked_overrides, read_document
from ctrplan.storage.toml_table import Table, file_inside

ROBOT_PREFIX = "robot."
FRICTION = "friction"  # the key of [start] that is no joint


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


def _build(document: Document, for_robot: Sequence[str], allow_outside: bool) -> Scenario:
    entry = document.to(ScenarioEntry)
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    robot = load_robot(file_inside(entry.robot, document, allow_outside, "robot"), for_robot)
    goals = _goals(entry, robot, document)
    with images_kept():
        anatomy = tuple(anatomy_part(Table(document, ("anatomy", k), allow_outside)) for k in range(len(entry.anatomy)))
    refuse_targets_outside_images(anatomy, goals, document)
    return Scenario(
        name=entry.name or (Path(document.file).stem if document.file else "scenario"),
        robot=robot,
        base_position_m=read_only(np.multiply(entry.base.position_mm, 1e-3)),
        base_R=base_rotation(entry.base, document),
        registration=Registration(entry.base.position_sigma_mm * 1e-3, math.radians(entry.base.rotation_sigma_deg)),
        start=joint_values({k: v for k, v in entry.start.items() if k != FRICTION}, robot, document, "start"),
        start_friction=_start_friction(entry, document),
        goal=goals[-1],
        via=tuple(goals[:-1]),
        anatomy=anatomy,
        frame=entry.frame,
        fixtures=tuple(fixture(Table(document, ("fixture", k), allow_outside)) for k in range(len(entry.fixture))),
        margins=Margins(entry.margins.stability, entry.margins.max_strain),
        cost=_cost(entry.cost),
        planner=planner_settings(Table(document, ("planner",))),
        path=document.file,
        sha256=document.sha256,
        warnings=(*robot.warnings, *anatomy_notes(anatomy)),
    )


def _start_friction(entry: ScenarioEntry, document: Document) -> StartFriction:
    known = [name for name in get_args(StartFriction) if name != "observed"]  # which needs an observer's state
    value = entry.start.get(FRICTION, "unknown")
    if value not in known:
        raise document.fault(f"must be one of {', '.join(known)}", "start", FRICTION)
    return cast(StartFriction, value)


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
