"""The first scenario of a case: its robot, structures, targets, and a base at the entry that looks along it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.anatomy.images.header import read_header
from ctrplan.anatomy.images.image import ImageRefusal
from ctrplan.anatomy.images.image_file import is_image
from ctrplan.anatomy.mesh_file import stated_frame
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.anatomy.shape import Role
from ctrplan.base.arrays import Array
from ctrplan.cases.points import Named
from ctrplan.cases.request import Request
from ctrplan.cases.structures import Structure
from ctrplan.drive.drive import Drive
from ctrplan.errors import InputError

MARGIN_MM, TOLERANCE_MM = 0.5, 1.0
DIGITS = 6  # of a mm


def draft(
    request: Request,
    output: Path,
    frame: Frame,
    structures: Sequence[tuple[Structure, Role]],
    targets: Sequence[Named],
    start: Mapping[str, float],
) -> dict[str, Any]:
    """The content of scenario.toml in the folder `output`, with robot.toml beside it; [base] is still missing.

    start: joint values by name, in deg or mm. Raises InputError for a file that does not say its frame.
    """
    goals = [_goal(target, request) for target in targets]
    return {
        "name": Path((request.inputs or ("case",))[0]).resolve().name[-60:] or "case",
        "robot": "robot.toml",
        "frame": frame,
        "start": dict(start),
        **({"goal": goals[0]} if len(goals) == 1 else {"target": goals}),
        "anatomy": [part(one, role, request, output) for one, role in structures],
    }


def base(entry: Named, targets: Sequence[Named]) -> dict[str, Any]:
    """[base] at an entry, looking along its line, or at the middle of the targets."""
    middle = np.mean([target.points_mm[-1] for target in targets], axis=0)
    look_at = entry.points_mm[-1] if entry.is_line else middle
    return {"position_mm": _rounded(entry.points_mm[0]), "look_at": _rounded(look_at)}


def start_values(drive: Drive, joints: Array) -> dict[str, float]:
    """Joint values (m,) [rad or m] by name, in deg or mm."""
    return {name: round(value, DIGITS) + 0.0 for name, value in drive.named(joints).items()}


def _goal(target: Named, request: Request) -> dict[str, Any]:
    place = {"line_mm": [_rounded(p) for p in target.points_mm]} if target.is_line else None
    tolerance = TOLERANCE_MM if request.tolerance_mm is None else request.tolerance_mm
    name = {"name": target.name} if target.name else {}
    return {**name, **(place or {"tip_mm": _rounded(target.points_mm[0])}), "tolerance_mm": tolerance}


def part(structure: Structure, role: Role, request: Request, output: Path) -> dict[str, Any]:
    """[[anatomy]] of a structure. Raises InputError for a file that does not say its frame."""
    margin = MARGIN_MM if request.margin_mm is None else request.margin_mm
    kind, *rest = structure.entry.items()
    found = {kind[0]: kind[1], **_files(structure, request, output), **dict(rest)}
    is_volume = structure.entry["kind"] == "volume"
    if not is_volume and request.repair is not None:
        found["repair"] = request.repair
    if is_volume and request.surface_error_mm is not None:
        found["surface_error_mm"] = request.surface_error_mm
    if any(_said_frame(file) is None for file in (structure.file, *structure.phases)):
        if request.file_frame is None:
            rule = "does not say whether its coordinates are in RAS or in LPS: --file-frame says it"
            raise InputError(rule, file=structure.file)
        found["frame"] = request.file_frame
    return {**found, "role": role, "margin_mm": margin}


def _files(structure: Structure, request: Request, output: Path) -> dict[str, Any]:
    if not structure.phases:
        return {"file": from_folder(output, structure.file)}
    every = [from_folder(output, file) for file in (structure.file, *structure.phases)]
    return {"files": every, "motion_margin_mm": request.motion_margin_mm or 0.0}


def _said_frame(path: Path) -> Frame | None:
    try:
        if path.is_dir():
            return "LPS"  # DICOM
        return read_header(path).frame if is_image(path) else stated_frame(path)
    except ImageRefusal as refusal:
        raise InputError(str(refusal), file=path) from refusal.__cause__


def from_folder(folder: Path, file: Path) -> str:
    """The way from a folder, which need not be there yet, to a file."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def _rounded(point_mm: Array) -> list[float]:
    rounded = np.round(point_mm, DIGITS) + 0.0  # no minus zero
    return [float(x) for x in rounded]
