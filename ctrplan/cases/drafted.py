"""What a draft says, read: its scenario, or the shape of one structure; what is refused is said of the file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from ctrplan.anatomy.mesh_defect import MeshDefectError
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.anatomy.shape import Role, Shape
from ctrplan.base.units import MM_PER_M
from ctrplan.cases.draft import part
from ctrplan.cases.moving import between_phases_mm, with_margin
from ctrplan.cases.structures import Structure
from ctrplan.cases.work import SCENARIO, Work
from ctrplan.errors import InputError
from ctrplan.files.scenario_anatomy import MOTION, anatomy_notes, anatomy_part
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.planning.scenario import Scenario
from ctrplan.storage.toml_document import Document
from ctrplan.storage.toml_table import Table

SMALLEST_MM = 2.0  # of a structure of a patient
PART = re.compile(r"anatomy\.(\d+)\b")


def drafted(work: Work, content: dict[str, Any], robot: str, structures: Sequence[Structure]) -> Scenario:
    """The scenario of the content, its robot where it comes from, since nothing is written yet. Raises InputError."""
    with _said_of(structures):
        scenario = scenario_from_dict({**content, "robot": robot}, file=str(work.file(SCENARIO)), allow_outside=True)
    for part, structure in zip(scenario.anatomy, structures, strict=False):  # a sheath comes after them
        across_mm = float(np.max(part.box[1] - part.box[0])) * MM_PER_M
        if structure.entry["kind"] == "mesh" and across_mm < SMALLEST_MM:
            rule = f"is {across_mm:.3g} mm across: are its coordinates in metres? --unit says so"
            raise InputError(rule, file=structure.file)
    return scenario


def shape_of(work: Work, structure: Structure, frame: Frame) -> Shape:
    """A structure by itself in the case's frame. Raises InputError."""
    role: Role = "avoid"
    content = {"frame": frame, "anatomy": [part(structure, role, work.request, work.folder)]}
    document = Document.of(content, "scenario", str(work.file(SCENARIO)))
    with _said_of([structure]):
        return anatomy_part(Table(document, ("anatomy", 0), True)).shape


def with_motion_margins(work: Work, scenario: Scenario, content: dict[str, Any]) -> Scenario:
    """The scenario with what is kept for places between phases, where nobody says it; said in the content, too."""
    if work.request.motion_margin_mm is not None:
        return scenario
    parts = list(scenario.anatomy)
    for k, part in enumerate(parts):
        if (margin_mm := between_phases_mm(part)) is not None:
            parts[k] = with_margin(part, margin_mm)
            content["anatomy"][k][MOTION] = margin_mm
            name = part.shape.name
            work.note(f"{name}: {margin_mm:g} mm are kept between phases, half the way from one to the next")
    return replace(scenario, anatomy=tuple(parts), warnings=(*scenario.robot.warnings, *anatomy_notes(parts)))


@contextmanager
def _said_of(structures: Sequence[Structure]) -> Iterator[None]:
    """What is refused of a part of the anatomy is said of its structure's file."""
    try:
        yield
    except InputError as error:
        match = PART.match(error.key or "")
        if match is None or not 0 < int(match[1]) <= len(structures):
            raise
        told = InputError(error.rule, file=structures[int(match[1]) - 1].file)
        raise (MeshDefectError(told, error.defect) if isinstance(error, MeshDefectError) else told) from error
