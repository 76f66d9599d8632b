"""The first scenario of a case: its robot, structures, targets, and a base at the entry that looks along it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.anatomy.image import ImageRefusal
from ctrplan.anatomy.image_file import is_image, stated_image_frame
from ctrplan.anatomy.mesh_file import stated_frame
from ctrplan.anatomy.mesh_repair import MeshDefectError
from ctrplan.anatomy.parts import AnatomyPart, combined_clearance, exact_clearance, surface_distance
from ctrplan.anatomy.patient_frame import TURNED, Frame
from ctrplan.anatomy.shape import PartShape, Role
from ctrplan.base.arrays import MM_DIGITS, MM_PER_M, Array, spread_directions, unit
from ctrplan.drive.drive import Drive
from ctrplan.errors import InputError
from ctrplan.files.scenario_anatomy import MOTION, anatomy_notes, anatomy_part
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.files.slicer_markups import PlacedMarkup
from ctrplan.patients.points import WORDS, Named, is_point, says
from ctrplan.patients.request import MARGIN_MM, TOLERANCE_MM, Place, Request
from ctrplan.patients.structures import CaseContent, Structure, between_phases_mm, matching, with_margin
from ctrplan.patients.work import SCENARIO, Work
from ctrplan.planning.room import blocked
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.toml_document import Document, TomlTable

BEHIND_MM, LONGEST_MM, STEP_MM = 10.0, 150.0, 0.5


def sheath(scenario: Scenario, entry_m: Array, towards_m: Array, radius_mm: float) -> dict[str, Any]:
    """[[anatomy]] of a sheath that begins behind the entry (3,) and ends where the lumen is as wide as the sheath.

    Near the seam of two lumens less room is counted than there is, so it reaches to where the lumen's own counts as
    much. Raises InputError where the straight way meets no lumen, with how near it comes.
    """
    way = unit(towards_m - entry_m)
    along_mm = np.arange(0, LONGEST_MM + STEP_MM, STEP_MM)
    points = entry_m + along_mm[:, None] / MM_PER_M * way
    depth_mm = _depth(scenario, points) * MM_PER_M
    enough = np.flatnonzero(depth_mm >= radius_mm)
    if len(enough):
        end = along_mm[enough[0]]
    elif depth_mm.max() > 0:  # a lumen narrower than the sheath: to its middle
        end = along_mm[int(np.argmax(depth_mm))]
    else:
        apart = f"it passes {-depth_mm.max():.3g} mm by"
        rule = f"the straight way from the entry meets no lumen in {LONGEST_MM:g} mm, {apart}"
        raise InputError(rule, key="--sheath-mm", value=radius_mm)
    return {
        "kind": "capsule",
        "from_mm": _shown(entry_m * MM_PER_M - BEHIND_MM * way),
        "to_mm": _shown(entry_m * MM_PER_M + end * way),
        "radius_mm": radius_mm,
        "role": "inside",
        "margin_mm": 0.0,
    }


def _depth(scenario: Scenario, points_m: Array) -> Array:
    lumens = [part for part in scenario.anatomy if part.role == "inside"]
    if not lumens:
        raise InputError("leads into a lumen, and none was said: --lumen NAME", key="--sheath-mm")
    bare = [AnatomyPart(part.shape, part.role, 0.0) for part in lumens]
    return np.asarray(combined_clearance(bare, lambda part: surface_distance(part, points_m)))


def _shown(point_mm: Array) -> list[float]:
    return [float(x) for x in np.round(point_mm, 3) + 0.0]


DIRECTIONS, SHELLS = 400, 60
FARTHEST_M = 30e-3  # at which room is looked for
SLACK_M = 1e-4
LEAST_WAY_M = 2e-3  # between an entry and a target


def refuse_targets_without_room(scenario: Scenario) -> None:
    """Raises InputError for a target in tissue or too near to it, with how far, and the nearest place with room."""
    needed = scenario.robot.tubes[-1].outer_diameter_m / 2 + scenario.robot.model_error_m
    for goal in scenario.targets:
        if goal.tip_m is not None and (why := blocked(scenario, goal.tip_m, needed, goal.tolerance_m)):
            raise _refusal(scenario, f"target {_place_in_words(goal.tip_m)}", goal.tip_m, needed, why)


def refuse_entry_without_room(scenario: Scenario, entry_m: Array, radius_m: float) -> None:
    """Raises InputError for a plate's place (3,) that lies at a target, or where tubes have no room within a radius.

    Base poses are looked for within that radius, so the entry itself need not have room.
    """
    away = min(float(np.linalg.norm(goal.tip_m - entry_m)) for goal in scenario.targets if goal.tip_m is not None)
    if away < LEAST_WAY_M:
        rule = f"is {away * MM_PER_M:.3g} mm from a target: are its numbers in metres, not in millimetres?"
        raise InputError(rule, key=f"entry {_place_in_words(entry_m)}")
    needed = scenario.robot.tubes[0].outer_diameter_m / 2
    if why := blocked(scenario, entry_m, needed, 0.0):
        near = nearest_room(scenario, entry_m, needed)
        if near is not None and np.linalg.norm(near - entry_m) <= radius_m:
            return
        raise _refusal(scenario, f"entry {_place_in_words(entry_m)}", entry_m, needed, why)


def _refusal(scenario: Scenario, place: str, point_m: Array, needed_m: float, why: str) -> InputError:
    near = nearest_room(scenario, point_m, needed_m)
    if near is not None:
        apart = np.linalg.norm(near - point_m) * MM_PER_M
        return InputError(
            f"{why}; the nearest place with room is {_place_in_words(near)}, {apart:.3g} mm away", key=place
        )
    others = {
        "with x and y turned round there is room: is it in the other frame": TURNED * point_m,
        "taken for metres there is room: are its numbers in metres": point_m * MM_PER_M,
    }
    for hint, other in others.items():
        if nearest_room(scenario, other, needed_m) is not None:
            return InputError(f"{why}; {hint}?", key=place)
    return InputError(f"{why}; within {FARTHEST_M * MM_PER_M:g} mm there is no room either", key=place)


def nearest_room(scenario: Scenario, point_m: Array, needed_m: float) -> Array | None:
    """(3,) [m] near a point (3,) where a ball of that radius keeps all margins; None where there is none near."""
    away = np.linspace(0, FARTHEST_M, SHELLS)
    tried = (point_m + away[:, None, None] * spread_directions(DIRECTIONS)).reshape(-1, 3)
    fits = exact_clearance(scenario.anatomy, tried) >= needed_m + SLACK_M
    if not fits.any():
        return None
    return np.asarray(np.round(tried[int(np.argmax(fits))] * MM_PER_M, 1) / MM_PER_M)


def _place_in_words(point_m: Array) -> str:
    return "[" + ", ".join(f"{x + 0.0:g}" for x in np.round(point_m * MM_PER_M, 3)) + "] mm"


ACROSS = 24  # places along each side of a body's box at which its depth is looked at
TARGET = "--target"


def aimed_at(case_content: CaseContent, places: Sequence[Place] | None, roles: Sequence[str]) -> dict[str, Structure]:
    """Structures that are targets, by what they are called: as said, or by their names where nothing is said.

    roles: what the options say of structures; one that has a role by them is no target by its name.
    """
    if places is not None:
        names = [place for place in places if isinstance(place, str) and not is_point(place, case_content.markups)]
        return {name: structure for name in names if (structure := matching(case_content, TARGET, name)) is not None}
    if any(says(markup, WORDS[TARGET]) for markup in case_content.markups):
        return {}
    named = [matching(case_content, TARGET, name) for name in roles]
    return {
        structure.name: structure
        for structure in case_content.structures
        if structure not in named and WORDS[TARGET].search(structure.name)
    }


def middles(
    aimed: dict[str, Structure], frame: Frame, shape_of: Callable[[Structure], PartShape]
) -> tuple[list[PlacedMarkup], list[str]]:
    """The middle of each as a point in the case's frame that is called as the structure is, and a note of where."""
    points, notes = [], []
    for name, structure in aimed.items():
        middle_mm = np.round(middle_m(shape_of(structure)) * MM_PER_M, 3) + 0.0
        points.append(PlacedMarkup(str(structure.file), middle_mm[None], (name,), frame, False))
        place = ", ".join(f"{x:g}" for x in middle_mm)
        notes.append(f"{structure.called} is a target: its middle [{place}] mm in {frame}")
    return points, notes


def middle_m(shape: PartShape) -> Array:
    """(3,) centre of a body's volume [m]; of one that is hollow or bent away from it, the place deepest within."""
    surface = shape.surface()
    origin = surface.vertices_m.mean(axis=0)
    corners = surface.vertices_m[surface.faces] - origin
    volumes = np.einsum("fx,fx->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    centre = origin + volumes @ corners.sum(axis=1) / (4 * volumes.sum())
    if shape.distance(centre[None])[0] < 0:
        return np.asarray(centre)
    lower, upper = shape.box()
    share = (np.indices((ACROSS,) * 3).reshape(3, -1).T + 0.5) / ACROSS
    tried = lower + share * (upper - lower)
    return np.asarray(tried[int(np.argmin(shape.distance(tried)))])


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
        "name": Path(request.get("inputs", ("case",))[0]).resolve().name[-60:] or "case",
        "robot": "robot.toml",
        "frame": frame,
        "start": dict(start),
        **({"goal": goals[0]} if len(goals) == 1 else {"target": goals}),
        "anatomy": [structure_entry(structure, role, request, output) for structure, role in structures],
    }


def base_at(entry: Named, targets: Sequence[Named]) -> dict[str, Any]:
    """[base] at an entry, looking along its line, or at the middle of the targets."""
    middle = np.mean([target.points_mm[-1] for target in targets], axis=0)
    look_at = entry.points_mm[-1] if entry.is_line else middle
    return {"position_mm": _rounded(entry.points_mm[0]), "look_at": _rounded(look_at)}


def start_values(drive: Drive, joints: Array) -> dict[str, float]:
    """Joint values (m,) [rad or m] by name, in deg or mm."""
    return {name: round(value, MM_DIGITS) + 0.0 for name, value in drive.named(joints).items()}


def _goal(target: Named, request: Request) -> dict[str, Any]:
    place = {"line_mm": [_rounded(p) for p in target.points_mm]} if target.is_line else None
    name = {"name": target.name} if target.name else {}
    return {
        **name,
        **(place or {"tip_mm": _rounded(target.points_mm[0])}),
        "tolerance_mm": request.get("tolerance_mm", TOLERANCE_MM),
    }


def structure_entry(structure: Structure, role: Role, request: Request, output: Path) -> dict[str, Any]:
    """[[anatomy]] of a structure. Raises InputError for a file that does not say its frame."""
    kind, *rest = structure.entry.items()
    results = {kind[0]: kind[1], **_files(structure, request, output), **dict(rest)}
    is_volume = structure.entry["kind"] == "volume"
    if not is_volume and "repair" in request:
        results["repair"] = request["repair"]
    if is_volume and "surface_error_mm" in request:
        results["surface_error_mm"] = request["surface_error_mm"]
    if any(_said_frame(file) is None for file in (structure.file, *structure.phases)):
        if "file_frame" not in request:
            rule = "does not say whether its coordinates are in RAS or in LPS: --file-frame says it"
            raise InputError(rule, file=structure.file)
        results["frame"] = request["file_frame"]
    return {**results, "role": role, "margin_mm": request.get("margin_mm", MARGIN_MM)}


def _files(structure: Structure, request: Request, output: Path) -> dict[str, Any]:
    if not structure.phases:
        return {"file": from_folder(output, structure.file)}
    every = [from_folder(output, file) for file in (structure.file, *structure.phases)]
    return {"files": every, "motion_margin_mm": request.get("motion_margin_mm", 0.0)}


def _said_frame(path: Path) -> Frame | None:
    try:
        if path.is_dir():
            return "LPS"  # DICOM
        return stated_image_frame(path) if is_image(path) else stated_frame(path)
    except ImageRefusal as refusal:
        raise InputError(str(refusal), file=path) from refusal.__cause__


def from_folder(folder: Path, file: Path) -> str:
    """The way from a folder, which need not be there yet, to a file."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def _rounded(point_mm: Array) -> list[float]:
    rounded = np.round(point_mm, MM_DIGITS) + 0.0  # no minus zero
    return [float(x) for x in rounded]


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


def shape_of(work: Work, structure: Structure, frame: Frame) -> PartShape:
    """A structure by itself in the case's frame. Raises InputError."""
    role: Role = "avoid"
    content = {"frame": frame, "anatomy": [structure_entry(structure, role, work.request, work.folder)]}
    document = Document.of(content, "scenario", str(work.file(SCENARIO)))
    with _said_of([structure]):
        return anatomy_part(TomlTable(document, ("anatomy", 0), True)).shape


def with_motion_margins(work: Work, scenario: Scenario, content: dict[str, Any]) -> Scenario:
    """The scenario with what is kept for places between phases, where nobody says it; said in the content, too."""
    if "motion_margin_mm" in work.request:
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
        refusal = InputError(error.rule, file=structures[int(match[1]) - 1].file)
        raise (MeshDefectError(refusal, error.defect) if isinstance(error, MeshDefectError) else refusal) from error
