"""The steps of a case: scenario, bases, placed scenario, plan, scene of 3D Slicer; each makes files from those
before.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.anatomy.shape import Role
from ctrplan.anatomy.structure import images_kept
from ctrplan.base.arrays import MM_PER_M, Array, shortest_rotation
from ctrplan.base.package import counted
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.files.file_content import content_at
from ctrplan.files.plan_file import load_plan
from ctrplan.files.robot_file import load_robot
from ctrplan.files.slicer_markups import SCENE, patient_frame
from ctrplan.files.trajectory_file import trajectory_formats
from ctrplan.patients.draft import (
    aimed_at,
    base_at,
    draft,
    drafted,
    from_folder,
    middles,
    refuse_entry_without_room,
    refuse_targets_without_room,
    shape_of,
    sheath,
    start_values,
    with_motion_margins,
)
from ctrplan.patients.points import Named, case_frame, places_of
from ctrplan.patients.request import (
    CANDIDATES,
    CONE_DEG,
    TRIES,
    BasesOptions,
    Inputs,
    PlanOptions,
    ScenarioOptions,
    part,
)
from ctrplan.patients.structures import Structure, chosen, content_of
from ctrplan.patients.work import (
    BASES,
    ENTRIES,
    PLACED,
    PLAN,
    ROBOT,
    SCENARIO,
    SLICER,
    CaseStep,
    Record,
    Work,
    bases_text,
    file_of,
    patch_radius_m,
    raw_files,
    read_bases,
    renamed,
    sources,
    stamp_of,
)
from ctrplan.planning.base_pose import BasePose
from ctrplan.planning.place import Placement, place
from ctrplan.planning.planner import plan
from ctrplan.planning.search.stage_search import Progress
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_words import worst_arrival
from ctrplan.scenario.joint_space import retracted
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.csv_table import CsvTable
from ctrplan.storage.output_folder import output_folder, write_atomically, write_results
from ctrplan.storage.toml_document import read_document, toml_text

DEFAULT_ROBOT = "three_tube_insertion.toml"
ENTRY_COLUMNS = "x_mm,y_mm,z_mm,look_x_mm,look_y_mm,look_z_mm"


class ScenarioStep(CaseStep):
    """Reads everything once and refuses what can't be planned with."""

    name = "scenario"
    files = (SCENARIO, ROBOT, ENTRIES)

    def made_from(self, work: Work) -> object:
        request = work.request
        places = [file_of(place)[0] for place in (*request.get("targets", ()), *request.get("entries", ()))]
        read = [*sources(request.get("inputs", ()), work.folder), *(Path(file) for file in places if file)]
        read.append(robot_file(request.get("robot")))
        said = renamed(request, lambda name: str(Path(name).resolve()))
        return [part(said, Inputs, ScenarioOptions), [stamp_of(path) for path in read]]

    def make(self, work: Work) -> str:
        request = work.request
        if not request.get("inputs"):
            raise InputError("are needed: images, meshes and files of markups, or folders of them", key="FILES")
        robot_text = _text(robot_file(request.get("robot")))
        with images_kept():
            task = _task(work)
            content, scenario = _drafted(work, task)
        refuse_targets_without_room(scenario)
        for entry in task.entries:
            refuse_entry_without_room(scenario, entry.points_mm[0] / 1e3, patch_radius_m(request))
        for warning in scenario.warnings:
            work.note(warning)
        write_atomically(work.file(ROBOT), robot_text)
        write_atomically(work.file(ENTRIES), _more(task.entries, task.targets))
        write_atomically(work.file(SCENARIO), _with_head(content))
        robot = load_robot(work.file(ROBOT))
        work.keep(SCENARIO, replace(scenario, robot=robot, content=content))
        return task.sentence


@dataclass(frozen=True, eq=False)
class _CaseTask:
    """What the files and options say."""

    frame: Frame
    structures: Sequence[tuple[Structure, Role]]
    targets: Sequence[Named]
    entries: Sequence[Named]

    @property
    def sentence(self) -> str:
        roles = [
            f"{structure.name} ({'inside' if role == 'inside' else 'avoid'})" for structure, role in self.structures
        ]
        counts = f"{counted(len(self.targets), 'target')}, {counted(len(self.entries), 'entry')}"
        return f"{', '.join(roles)}; {counts}, in {self.frame}"


def _task(work: Work) -> _CaseTask:
    """Structures with their roles, targets and entries; what was recognised is told. Raises InputError."""
    request = work.request
    inputs, phases = request.get("inputs", ()), request.get("phases", ())
    result = content_of(inputs, request.get("unit"), work.folder, request.get("series"), phases)
    lumens, avoids, ignored = request.get("lumens", ()), request.get("avoids", ()), request.get("ignored", ())
    aimed = aimed_at(result, request.get("targets"), (*lumens, *avoids, *ignored))
    for sentence in result.notes:
        work.note(sentence)
    structures, sentences = chosen(result, lumens, avoids, ignored, tuple(aimed.values()))
    frame = case_frame(request.get("frame"), [*request.get("targets", ()), *request.get("entries", ())])
    points, more = middles(aimed, frame, lambda structure: shape_of(work, structure, frame))
    for sentence in (*sentences, *more):
        work.note(sentence)
    targets = places_of(
        "--target", request.get("targets"), [*result.markups, *points], frame, request.get("file_frame")
    )
    entries = places_of("--entry", request.get("entries"), result.markups, frame, request.get("file_frame"))
    told_of = [*(item.notes for item in result.markups), *(item.notes for item in (*targets, *entries))]
    for sentence in dict.fromkeys(note for notes in told_of for note in notes):
        work.note(sentence)
    return _CaseTask(frame, structures, targets, entries)


def _drafted(work: Work, task: _CaseTask) -> tuple[dict[str, Any], Scenario]:
    """The scenario, as the content of its file and read."""
    request, structures = work.request, [structure for structure, _ in task.structures]
    robot = load_robot(robot_file(request.get("robot")))
    start = start_values(robot.drive, retracted(robot))
    content = draft(request, work.folder, task.frame, task.structures, task.targets, start)
    content["base"] = base_at(task.entries[0], task.targets)
    beside = from_folder(work.folder, robot_file(request.get("robot")))
    scenario = with_motion_margins(work, drafted(work, content, beside, structures), content)
    if "sheath_mm" in request:
        sheaths = _sheaths(scenario, task.entries, task.targets, request["sheath_mm"])
        content["anatomy"] += sheaths
        alone = drafted(work, {**content, "anatomy": sheaths}, beside, ())  # images are not read again
        scenario = replace(scenario, anatomy=scenario.anatomy + alone.anatomy)
    return content, scenario


def robot_file(file: str | os.PathLike[str] | None) -> Path:
    """The robot's file as said, or that of the robot which cases are planned with where none is."""
    return Path(file) if file else Path(str(files("ctrplan.patients") / "robots" / DEFAULT_ROBOT))


def _text(robot: Path) -> str:
    load_robot(robot)  # refuses what is none
    return robot.read_text(encoding="utf-8-sig")


def _sheaths(
    scenario: Scenario, entries: Sequence[Named], targets: Sequence[Named], radius_mm: float
) -> list[dict[str, Any]]:
    looks = [base_at(entry, targets)["look_at"] for entry in entries]
    return [
        sheath(scenario, entry.points_mm[0] / 1e3, np.divide(look, 1e3), radius_mm)
        for entry, look in zip(entries, looks, strict=True)
    ]


def _more(entries: Sequence[Named], targets: Sequence[Named]) -> str:
    """Entries besides the first, which is the scenario's base."""
    rows = [base_at(entry, targets) for entry in entries[1:]]
    lines = [",".join(map(repr, [*row["position_mm"], *row["look_at"]])) for row in rows]
    return "\n".join([ENTRY_COLUMNS, *lines]) + "\n"


def _with_head(content: dict[str, Any]) -> str:
    head = (
        "# Made by `ctrplan case`. Edit it and run `ctrplan case -o` on this folder again: what follows is made anew."
    )
    return f"{head}\n{toml_text(content)}"


class BasesStep(CaseStep):
    """`ctrplan.place` from each entry."""

    name = "bases"
    files = (BASES,)

    def made_from(self, work: Work) -> object:
        options = part(work.request, BasesOptions) | {"seed": work.request.get("seed")}
        return [options, work.state(SCENARIO, ROBOT, ENTRIES), raw_files(work.scenario(SCENARIO))]

    def make(self, work: Work) -> str:
        result, reasons, tried = list[BasePose](), list[str](), 0
        for scenario in self._entries(work):
            try:
                placement = self._placed(work, scenario)
                tried += placement.drawn
                result += [pose for pose in placement.poses if pose.reached]
                reasons += [] if placement.poses[0].reached else [placement.sentence.rstrip(".")]
            except NoAnswerError as error:
                reasons.append(str(error).partition(": ")[2].rstrip(".") or str(error))
        if not result:
            place_mm = ", ".join(f"{x:.4g}" for x in work.scenario(SCENARIO).base_position_m * MM_PER_M)
            rule = f"nothing is reached from the entry [{place_mm}] mm: {reasons[0]}"
            raise NoAnswerError(f"{work.file(SCENARIO)}: {rule}. Another entry, --cone-deg or --radius-mm may help.")
        ranked = sorted(result, key=lambda pose: pose.rank)
        write_atomically(work.file(BASES), bases_text(ranked))
        best = ranked[0]
        error_mm = max(target.worst_m for target in best.targets if target.best) * MM_PER_M
        reached = f"{best.reached} of {len(best.targets)} targets"
        return f"{len(ranked)} poses of {tried} tried; the best reaches {reached}, {error_mm:.2f} mm off at worst"

    def _placed(self, work: Work, scenario: Scenario) -> Placement:
        request = work.request
        placement = place(
            scenario,
            aim_m=scenario.base_position_m + scenario.base_R[:, 2] * _away(scenario),
            radius_m=patch_radius_m(request),
            cone_rad=math.radians(request.get("cone_deg", CONE_DEG)),
            candidates=request.get("candidates", CANDIDATES),
            seed=request.get("seed", 0),
            progress=work.progress,
            interrupted=work.stop,
        )
        if work.stop.is_set():
            raise KeyboardInterrupt
        return placement

    def _entries(self, work: Work) -> list[Scenario]:
        """The scenario with its robot at each entry."""
        own = work.scenario(SCENARIO)
        file = work.file(ENTRIES)
        lines = file.read_text().strip().splitlines() if file.exists() else []
        if len(lines) < 2:
            return [own]
        table = CsvTable(str(file), "table of entries")
        rows = table.columns(ENTRY_COLUMNS.split(",")) / MM_PER_M
        return [own, *(_standing(own, row, table, k) for k, row in enumerate(rows))]


def _standing(scenario: Scenario, row: Array, table: CsvTable, k: int) -> Scenario:
    if not np.any(row[3:] - row[:3]) or not np.abs(row).max() < 10:
        raise table.fault("must be two places near each other", k)
    turned = shortest_rotation(row[3:] - row[:3])
    return replace(scenario, base_position_m=row[:3], base_R=turned)


def _away(scenario: Scenario) -> float:
    """How far the targets are [m], at least a mm."""
    tips = [goal.tip_m for goal in scenario.targets if goal.tip_m is not None]
    if not tips:
        raise InputError("says nothing of a place: a tip is needed", file=scenario.path, key="goal")
    return max(1e-3, float(np.linalg.norm(np.mean(tips, axis=0) - scenario.base_position_m)))


class PlacedStep(CaseStep):
    """The first row of the table; the plan tries the next ones where that has none."""

    name = "placed"
    files = (PLACED,)

    def made_from(self, work: Work) -> object:
        return work.state(SCENARIO, BASES)

    def make(self, work: Work, number: int = 1) -> str:
        rows = read_bases(work.file(BASES))
        if number > len(rows):
            raise InputError(f"has {len(rows)} poses", file=work.file(BASES), key="row", value=number)
        pose = rows[number - 1]
        content = content_at(read_document(work.file(SCENARIO)).content, pose)
        head = f"# Row {number} of {BASES}, by `ctrplan case`. Edit it, and the next run plans from here."
        write_atomically(work.file(PLACED), f"{head}\n{toml_text(content)}")
        kept = replace(
            work.scenario(SCENARIO),
            base_position_m=pose.position_m,
            base_R=pose.R,
            path=str(work.file(PLACED)),
            content=content,
        )
        work.keep(PLACED, kept)
        position = ", ".join(f"{x:.1f}" for x in pose.position_m * MM_PER_M)
        way = ", ".join(f"{x:.3f}" for x in pose.direction)
        return f"row {number} of {BASES}: at [{position}] mm, looking along [{way}]"


class PlanStep(CaseStep):
    """Plans from the base pose that was chosen, and from the next ones of the table where it has no plan."""

    name = "plan"
    files = ()
    results = (f"{PLAN}/plan.json", f"{PLAN}/report.html")

    def made_from(self, work: Work) -> object:
        options = part(work.request, PlanOptions)
        return [options, work.state(PLACED, ROBOT), raw_files(work.scenario(PLACED))]

    def make(self, work: Work) -> str:
        from ctrplan.reports.plan_page import FORMATS, plan_outputs, save_plan  # pictures take a second to import

        output_folder(str(work.file(PLAN)), plan_outputs(trajectory_formats(FORMATS)))
        first = _row(work.record)
        made = self._planned(work)
        save_plan(made, work.file(PLAN))
        work.plan = made
        row = _row(work.record)
        return _sentence(made) if row == first else f"from row {row} of {BASES}: {_sentence(made)}"

    def _planned(self, work: Work) -> Plan:
        request, record = work.request, work.record
        rows = 1 if record.edited("placed") else len(read_bases(work.file(BASES)))
        number = _row(record)
        last = min(rows, number - 1 + request.get("bases", TRIES))

        def report(progress: Progress) -> None:
            work.progress(progress.stage, progress.fraction)

        while True:
            try:
                return plan(
                    work.scenario(PLACED),
                    seed=request.get("seed", 0),
                    time_s=request.get("time_s"),
                    progress=report,
                    interrupted=work.stop,
                )
            except NoAnswerError as error:
                if number >= last or work.stop.is_set():
                    raise
                work.note(f"no plan from row {number} of {BASES}: {error}")
            number += 1
            step = PlacedStep()
            record.begin(step.name)
            sentence = step.make(work, number)
            work.end(step, sentence, number)


def _row(record: Record) -> int:
    """The row of the table of bases that stands in placed.toml."""
    return record.steps["placed"].chosen if "placed" in record.steps else 1


def _sentence(made: Plan) -> str:
    """Whether it is certified, where the tip arrives, and how near the robot comes."""
    certificate = made.certificate
    arrival = worst_arrival(made)
    parts = [f"{'certified' if certificate.valid else 'NOT certified'}, {len(made.legs)} legs"]
    parts += [arrival.sentence] if arrival else []
    if math.isfinite(certificate.min_clearance_m):
        parts.append(f"clearance {certificate.min_clearance_m * MM_PER_M:.2f} mm beyond the margins")
    return "; ".join(parts)


STEPS = 40  # poses of the motion


class SlicerStep(CaseStep):
    """A scene of 3D Slicer, as `ctrplan export --to slicer` writes it."""

    name = "slicer"
    files = ()
    results = (f"{SLICER}/{SCENE}",)

    def made_from(self, work: Work) -> object:
        return work.state(f"{PLAN}/plan.json", f"{PLAN}/trajectory.csv")

    def make(self, work: Work) -> str:
        from ctrplan.reports.plan_scene import written_motion
        from ctrplan.reports.slicer_case import case_files  # surfaces take a second to import

        folder = output_folder(str(work.file(SLICER)), [SCENE])
        written = load_plan(work.file(f"{PLAN}/plan.json"), work.scenario(PLACED))
        for warning in written.warnings:
            work.note(warning)
        motion = written_motion(written, STEPS, lambda share: work.progress("solving", share))
        frame = work.request.get("frame") if written.scenario.frame is None else None  # of a scenario that people wrote
        files = case_files(motion, patient_frame(written.scenario, frame))
        write_results(folder, files)
        return f"{len(files)} files for 3D Slicer, {len(motion.path)} poses"
