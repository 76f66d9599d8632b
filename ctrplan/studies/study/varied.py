"""What stands in a study file -> axes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.errors import InputError
from ctrplan.files.study_entries import StudyEntry, VaryEntry
from ctrplan.storage.toml_document import Document, read_document
from ctrplan.studies.study.axes import TASK_PREFIX, Axis, BaseAxis, DrawAxis, FileAxis, KeyAxis, Range, TargetAxis
from ctrplan.studies.study.base_poses import base_poses
from ctrplan.studies.study.draws import drawn
from ctrplan.studies.study.points import target_points
from ctrplan.studies.study.sources import Sources, matching_files

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

ROBOT, SCENARIO = "robot", "scenario"
POSE, OTHER_WAYS = ("position_mm", "quaternion_wxyz"), ("direction", "look_at", "roll_deg")  # of [base]
GOAL_KEYS = ("tolerance_mm", "direction", "direction_tolerance_deg")


def files_varied(entry: StudyEntry, document: Document) -> dict[str, list[Path]]:
    """The files that each key with `files` goes through. Raises InputError."""
    folder = os.path.dirname(document.file or "") or "."
    return {
        vary.key: matching_files(vary.files, folder, f"vary.{k + 1}.files", document.file)
        for k, vary in enumerate(entry.vary)
        if vary.files is not None
    }


def axes_of(
    entry: StudyEntry,
    document: Document,
    sources: Sources,
    files: dict[str, list[Path]],
    scenario: Scenario | None,
) -> list[Axis]:
    """Files first, then bases and keys in the order of the file, draws, and targets, which run fastest.

    scenario: for points of its anatomy. Raises InputError.
    """
    folder = Path(document.file or ".").parent
    found: list[Axis] = [_files(vary, entry, sources, files[vary.key], folder) for vary in entry.vary if vary.files]
    if entry.bases is not None:
        found.append(BaseAxis(*base_poses(entry.bases, document), _beside_pose(entry, document, files)))
    found += [KeyAxis(vary.key, _values(vary)) for vary in entry.vary if vary.values or vary.count]
    if random := distributed(entry):
        found.append(DrawAxis([vary.key for vary in random], drawn(random, entry.draws)))
    if entry.targets is not None:
        points = target_points(entry.targets, scenario, document, folder)
        found.append(TargetAxis(points, _goal(entry), of_scenario=entry.scenario is not None))
    return found


def _beside_pose(
    entry: StudyEntry, document: Document, files: Mapping[str, Sequence[Path]]
) -> Mapping[str, Any] | None:
    """What [base] of the scenario says besides a pose, if a quaternion does not go with the rest; else None."""
    folder = Path(document.file or ".").parent
    bases = [read_document(file).content.get("base") for file in files.get(SCENARIO, [folder / (entry.scenario or "")])]
    tables = [base for base in bases if isinstance(base, dict)]
    if not any(key in table for table in tables for key in OTHER_WAYS):
        return None
    beside = [{key: value for key, value in table.items() if key not in (*POSE, *OTHER_WAYS)} for table in tables]
    if len(tables) < len(bases) or any(other != beside[0] for other in beside):
        raise document.fault("needs scenarios whose [base] say the same but for the pose", "bases")
    return beside[0]


def distributed(entry: StudyEntry) -> list[VaryEntry]:
    """The keys that have a distribution."""
    return [vary for vary in entry.vary if vary.distribution is not None]


def _values(vary: VaryEntry) -> Sequence[Any]:
    if vary.values is not None:
        return vary.values
    return Range(vary.low or 0.0, vary.high or 0.0, vary.count or 1)


def _files(vary: VaryEntry, entry: StudyEntry, sources: Sources, files: list[Path], folder: Path) -> FileAxis:
    """The axis of a key whose value is a file: the start itself, a file of the task, or one that the start names."""
    is_main = vary.key == (SCENARIO if entry.scenario is not None else ROBOT)
    if is_main:
        named = [sources.name(file) for file in files]
    elif vary.key.startswith(TASK_PREFIX):
        named = [os.path.relpath(file, folder) for file in files]
    else:
        if entry.scenario is None:
            raise InputError("a robot's file names no other files", key="vary", value=vary.key)
        named = [os.path.relpath(file, (folder / entry.scenario).parent) for file in files]
    others = [other.key for other in entry.vary if other.files is None]
    inner = [key.removeprefix("robot.") for key in others] if vary.key == ROBOT and not is_main else others
    digests = [sources.digest(sources.name(file), _of_file(inner)) for file in files]
    shown = _distinct_names(files)
    return FileAxis(vary.key, list(zip(shown, named, digests, strict=True)), is_main=is_main)


def _of_file(keys: Sequence[str]) -> list[str]:
    from ctrplan.studies.study.axes import is_of_task

    return [key for key in keys if not is_of_task(key)]


def _distinct_names(files: Sequence[Path]) -> list[str]:
    """File names, with as much of their folders as tells them apart."""
    for parts in range(1, max(len(file.parts) for file in files) + 1):
        names = ["/".join(file.parts[-parts:]) for file in files]
        if len(set(names)) == len(names):
            return names
    return [str(file) for file in files]


def _goal(entry: StudyEntry) -> dict[str, Any]:
    targets = entry.targets
    given = {key: getattr(targets, key) for key in GOAL_KEYS}
    goal = {
        key: list(value) if isinstance(value, tuple) else value for key, value in given.items() if value is not None
    }
    if "direction" in goal:
        goal.setdefault("direction_tolerance_deg", 5.0)
    return goal
