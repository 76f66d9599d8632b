"""Step 1: images, points and a robot become scenario.toml and robot.toml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.anatomy.images.kept import images_kept
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.anatomy.shape import Role
from ctrplan.cases.aims import aimed_at, middles
from ctrplan.cases.draft import base, draft, from_folder, start_values
from ctrplan.cases.drafted import drafted, shape_of, with_motion_margins
from ctrplan.cases.inputs import found_in
from ctrplan.cases.points import Named, case_frame, places_of
from ctrplan.cases.record import stamp_of
from ctrplan.cases.request import patch_radius_m
from ctrplan.cases.roles import chosen
from ctrplan.cases.room import refuse_entry_without_room, refuse_targets_without_room
from ctrplan.cases.sheath import sheath
from ctrplan.cases.structures import Structure
from ctrplan.cases.work import ENTRIES, ROBOT, SCENARIO, Step, Work
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.planning.drawn_back import drawn_back
from ctrplan.planning.scenario import Scenario
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.storage.toml_document import Document
from ctrplan.storage.toml_text import toml_text

DEFAULT_ROBOT = "three_tube_insertion.toml"
UNIT = "mm"
ENTRY_COLUMNS = "x_mm,y_mm,z_mm,look_x_mm,look_y_mm,look_z_mm"


class ScenarioStep(Step):
    """Reads everything once and refuses what can't be planned with."""

    name = "scenario"
    files = (SCENARIO, ROBOT, ENTRIES)

    def made_from(self, work: Work) -> object:
        asked = work.request
        said = asked.part(
            "inputs",
            "targets",
            "entries",
            "frame",
            "file_frame",
            "unit",
            "repair",
            "series",
            "lumens",
            "avoids",
            "ignored",
            "phases",
            "motion_margin_mm",
        )
        said |= asked.part("robot", "margin_mm", "surface_error_mm", "tolerance_mm", "sheath_mm")
        stamps = [stamp_of(Path(name)) for name in asked.inputs or ()] + [stamp_of(robot_file(asked.robot))]
        return [said, stamps]

    def make(self, work: Work) -> str:
        asked = work.request
        if not asked.inputs:
            raise InputError("are needed: images, meshes and files of markups, or folders of them", key="FILES")
        robot_text = _text(robot_file(asked.robot))
        with images_kept():
            task = _task(work)
            content, scenario = _drafted(work, task)
        refuse_targets_without_room(scenario)
        for entry in task.entries:
            refuse_entry_without_room(scenario, entry.points_mm[0] / 1e3, patch_radius_m(asked))
        for warning in scenario.warnings:
            work.note(warning)
        write_atomically(work.file(ROBOT), robot_text)
        write_atomically(work.file(ENTRIES), _more(task.entries, task.targets))
        write_atomically(work.file(SCENARIO), _with_head(content))
        robot = load_robot(work.file(ROBOT))
        work.keep(SCENARIO, replace(scenario, robot=robot, sha256=Document(content).sha256))
        return task.sentence


@dataclass(frozen=True, eq=False)
class _Task:
    """What the files and options say."""

    frame: Frame
    structures: Sequence[tuple[Structure, Role]]
    targets: Sequence[Named]
    entries: Sequence[Named]

    @property
    def sentence(self) -> str:
        roles = [f"{one.name} ({'inside' if role == 'inside' else 'avoid'})" for one, role in self.structures]
        counts = f"{_counted(len(self.targets), 'target')}, {_counted(len(self.entries), 'entry')}"
        return f"{', '.join(roles)}; {counts}, in {self.frame}"


def _task(work: Work) -> _Task:
    """Structures with their roles, targets and entries; what was recognised is told. Raises InputError."""
    asked = work.request
    found = found_in(asked.inputs or (), asked.unit or UNIT, work.folder, asked.series, asked.phases or ())
    lumens, avoids, ignored = asked.lumens or (), asked.avoids or (), asked.ignored or ()
    aimed = aimed_at(found, asked.targets, (*lumens, *avoids, *ignored))
    for sentence in found.notes:
        work.note(sentence)
    structures, told = chosen(found, lumens, avoids, ignored, tuple(aimed.values()))
    frame = case_frame(asked.frame, [*(asked.targets or ()), *(asked.entries or ())])
    points, more = middles(aimed, frame, lambda one: shape_of(work, one, frame))
    for sentence in (*told, *more):
        work.note(sentence)
    targets = places_of("--target", asked.targets, [*found.markups, *points], frame, asked.file_frame)
    entries = places_of("--entry", asked.entries, found.markups, frame, asked.file_frame)
    return _Task(frame, structures, targets, entries)


def _drafted(work: Work, task: _Task) -> tuple[dict[str, Any], Scenario]:
    """The scenario, as the content of its file and read."""
    asked, structures = work.request, [one for one, _ in task.structures]
    robot = load_robot(robot_file(asked.robot))
    start = start_values(robot.drive, drawn_back(robot))
    content = draft(asked, work.folder, task.frame, task.structures, task.targets, start)
    content["base"] = base(task.entries[0], task.targets)
    beside = from_folder(work.folder, robot_file(asked.robot))
    scenario = with_motion_margins(work, drafted(work, content, beside, structures), content)
    if asked.sheath_mm is not None:
        sheaths = _sheaths(scenario, task.entries, task.targets, asked.sheath_mm)
        content["anatomy"] += sheaths
        alone = drafted(work, {**content, "anatomy": sheaths}, beside, ())  # images are not read again
        scenario = replace(scenario, anatomy=scenario.anatomy + alone.anatomy)
    return content, scenario


def robot_file(said: str | None) -> Path:
    """The robot's file as said, or that of the robot which cases are planned with where none is."""
    return Path(said) if said else Path(str(files("ctrplan.cases") / "robots" / DEFAULT_ROBOT))


def _text(robot: Path) -> str:
    load_robot(robot)  # refuses what is none
    return robot.read_text(encoding="utf-8-sig")


def _sheaths(
    scenario: Scenario, entries: Sequence[Named], targets: Sequence[Named], radius_mm: float
) -> list[dict[str, Any]]:
    looks = [base(entry, targets)["look_at"] for entry in entries]
    return [
        sheath(scenario, entry.points_mm[0] / 1e3, np.divide(look, 1e3), radius_mm)
        for entry, look in zip(entries, looks, strict=True)
    ]


def _more(entries: Sequence[Named], targets: Sequence[Named]) -> str:
    """Entries besides the first, which is the scenario's base."""
    rows = [base(entry, targets) for entry in entries[1:]]
    lines = [",".join(map(repr, [*row["position_mm"], *row["look_at"]])) for row in rows]
    return "\n".join([ENTRY_COLUMNS, *lines]) + "\n"


def _with_head(content: dict[str, Any]) -> str:
    head = (
        "# Made by `ctrplan case`. Edit it and run `ctrplan case -o` on this folder again: what follows is made anew."
    )
    return f"{head}\n{toml_text(content)}"


def _counted(count: int, thing: str) -> str:
    return (
        f"1 {thing}" if count == 1 else f"{count} {thing.removesuffix('y') + 'ie' if thing.endswith('y') else thing}s"
    )
