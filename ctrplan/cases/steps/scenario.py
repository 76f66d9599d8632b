"""Step 1: images, points and a robot become scenario.toml and robot.toml."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.anatomy.mesh_defect import MeshDefectError
from ctrplan.anatomy.shape import Role
from ctrplan.base.units import MM_PER_M
from ctrplan.cases import draft
from ctrplan.cases.inputs import Structure, found_in
from ctrplan.cases.points import Named, case_frame, places_of
from ctrplan.cases.record import stamp_of
from ctrplan.cases.request import patch_radius_m
from ctrplan.cases.roles import chosen
from ctrplan.cases.room import refuse_entry_without_room, refuse_targets_without_room
from ctrplan.cases.sheath import sheath
from ctrplan.cases.work import ENTRIES, ROBOT, SCENARIO, Step, Work
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.planning.drawn_back import drawn_back
from ctrplan.planning.scenario import Scenario
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.storage.toml_document import Document
from ctrplan.storage.toml_text import toml_text

DEFAULT_ROBOT = "three_tube_insertion.toml"
UNIT, SMALLEST_MM = "mm", 2.0  # of a structure of a patient
PART = re.compile(r"anatomy\.(\d+)\.")
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
        )
        said |= asked.part("robot", "margin_mm", "surface_error_mm", "tolerance_mm", "sheath_mm")
        stamps = [stamp_of(Path(name)) for name in asked.inputs or ()] + [stamp_of(robot_file(asked.robot))]
        return [said, stamps]

    def make(self, work: Work) -> str:
        asked = work.request
        if not asked.inputs:
            raise InputError("are needed: images, meshes and files of markups, or folders of them", key="FILES")
        robot_text = _text(robot_file(asked.robot))
        found = found_in(asked.inputs, asked.unit or UNIT, work.folder, asked.series)
        structures, told = chosen(found, asked.lumens or (), asked.avoids or (), asked.ignored or ())
        for sentence in (*found.notes, *told):
            work.note(sentence)
        frame = case_frame(asked.frame, [*(asked.targets or ()), *(asked.entries or ())])
        targets = places_of("--target", asked.targets, found.markups, frame, asked.file_frame)
        entries = places_of("--entry", asked.entries, found.markups, frame, asked.file_frame)
        robot = load_robot(robot_file(asked.robot))
        start = draft.start_values(robot.drive, drawn_back(robot))
        content = draft.draft(asked, work.folder, frame, structures, targets, start)
        content["base"] = draft.base(entries[0], targets)
        scenario = _checked(work, content, structures)
        if asked.sheath_mm is not None:
            content["anatomy"] += _sheaths(scenario, entries, targets, asked.sheath_mm)
            scenario = _checked(work, content, structures)
        refuse_targets_without_room(scenario)
        for entry in entries:
            refuse_entry_without_room(scenario, entry.points_mm[0] / 1e3, patch_radius_m(asked))
        for warning in scenario.warnings:
            work.note(warning)
        write_atomically(work.file(ROBOT), robot_text)
        write_atomically(work.file(ENTRIES), _more(entries, targets))
        write_atomically(work.file(SCENARIO), _with_head(content))
        robot = load_robot(work.file(ROBOT))
        work.keep(SCENARIO, replace(scenario, robot=robot, sha256=Document(content).sha256))
        roles = [f"{one.name} ({'inside' if role == 'inside' else 'avoid'})" for one, role in structures]
        return f"{', '.join(roles)}; {_counted(len(targets), 'target')}, {_counted(len(entries), 'entry')}, in {frame}"


def robot_file(said: str | None) -> Path:
    """The robot's file as said, or that of the robot which cases are planned with where none is."""
    return Path(said) if said else Path(str(files("ctrplan.cases") / "robots" / DEFAULT_ROBOT))


def _text(robot: Path) -> str:
    load_robot(robot)  # refuses what is none
    return robot.read_text(encoding="utf-8-sig")


def _checked(work: Work, content: dict[str, Any], structures: Sequence[tuple[Structure, Role]]) -> Scenario:
    """The scenario of the content, its robot where it comes from, since nothing is written yet.

    What it refuses of an image or a mesh is said of that file.
    """
    beside = {**content, "robot": draft.from_folder(work.folder, robot_file(work.request.robot))}
    try:
        scenario = scenario_from_dict(beside, file=str(work.file(SCENARIO)), allow_outside=True)
    except InputError as error:
        match = PART.match(error.key or "")
        if match is None or not 0 < int(match[1]) <= len(structures):
            raise
        told = InputError(error.rule, file=structures[int(match[1]) - 1][0].file)
        raise (MeshDefectError(told, error.defect) if isinstance(error, MeshDefectError) else told) from error
    for part, (structure, _) in zip(scenario.anatomy, structures, strict=False):  # a sheath comes after them
        across_mm = float(np.max(part.box[1] - part.box[0])) * MM_PER_M
        if structure.entry["kind"] == "mesh" and across_mm < SMALLEST_MM:
            rule = f"is {across_mm:.3g} mm across: are its coordinates in metres? --unit says so"
            raise InputError(rule, file=structure.file)
    return scenario


def _sheaths(
    scenario: Scenario, entries: Sequence[Named], targets: Sequence[Named], radius_mm: float
) -> list[dict[str, Any]]:
    looks = [draft.base(entry, targets)["look_at"] for entry in entries]
    return [
        sheath(scenario, entry.points_mm[0] / 1e3, np.divide(look, 1e3), radius_mm)
        for entry, look in zip(entries, looks, strict=True)
    ]


def _more(entries: Sequence[Named], targets: Sequence[Named]) -> str:
    """Entries besides the first, which is the scenario's base."""
    rows = [draft.base(entry, targets) for entry in entries[1:]]
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
