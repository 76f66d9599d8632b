"""What the steps of a case share: the record of what was made from what, bases.csv, the folder."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.image import ImageRefusal, data_files
from ctrplan.base.arrays import LONGEST_MM, MM_DIGITS, MM_PER_M, NORM_TOLERANCE
from ctrplan.base.long_work import StageProgress
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.files.slicer_markups import is_markups
from ctrplan.patients.request import RADIUS_MM, Request, request_of
from ctrplan.patients.structures import case_files
from ctrplan.planning.base_pose import DIGITS, BaseFrame, BasePose, as_written
from ctrplan.plans.plan import Plan
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.csv_table import CsvTable, csv_text, file_bytes
from ctrplan.storage.output_folder import write_atomically


def patch_radius_m(request: Request) -> float:
    """[m] around an entry in which base poses are looked for."""
    return request.get("radius_mm", RADIUS_MM) / MM_PER_M


FILE = "case.json"
LARGEST_FILE_BYTES = 5_000_000


@dataclass
class MadeFile:
    """One step's result: the key of what it was made from, and the hash of each file as it was written."""

    key: str = ""
    files: dict[str, str] = field(default_factory=dict)
    sentence: str = ""
    pending: bool = False  # begun, and perhaps killed
    chosen: int = 1  # row of bases.csv


class Record:
    """The file in a case's folder."""

    def __init__(self, folder: Path) -> None:
        """Reads it where it is there. Raises InputError for a file that is none of a case."""
        self.folder, self.request, self.steps = folder, Request(), dict[str, MadeFile]()
        self.is_new = not (folder / FILE).exists()
        if self.is_new:
            return
        text = file_bytes(str(folder / FILE), LARGEST_FILE_BYTES, "JSON", "record of a case")
        try:
            content = json.loads(text)
            said_in = folder / content.get("said_in", os.path.relpath(".", folder))
            self.request = renamed(request_of(content["request"]), lambda name: seen_from(said_in, name))
            self.steps = {name: MadeFile(**made) for name, made in content["steps"].items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError("is no record of a case: begin anew in another folder", file=folder / FILE) from None

    def write(self) -> None:
        """Writes the file, whole."""
        steps = {name: vars(made) for name, made in self.steps.items()}
        said_in = Path(os.path.relpath(".", self.folder)).as_posix()  # where the names of files begin
        content = {"request": self.request, "said_in": said_in, "steps": steps}
        write_atomically(self.folder / FILE, json.dumps(content, indent=1) + "\n")

    def edited(self, name: str) -> list[str]:
        """Files of a step that are not as it wrote them."""
        made = self.steps.get(name, MadeFile())
        if made.pending:
            return []
        return [file for file, digest in made.files.items() if digest_of(self.folder / file) != digest]

    def begin(self, name: str) -> None:
        """Notes that a step's files are about to be written: what a kill leaves is nobody's edit."""
        self.steps[name] = MadeFile(pending=True)
        self.write()

    def end(self, name: str, key: str, files: Mapping[str, str], sentence: str, chosen: int = 1) -> None:
        """Notes that they are there."""
        self.steps[name] = MadeFile(key, dict(files), sentence, chosen=chosen)
        self.write()


def digest_of(path: Path) -> str:
    """Hash of a file's bytes; empty where there is none."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def key_of(*parts: Any) -> str:
    """One hash of what JSON can say."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def stamp_of(path: Path) -> list[Any]:
    """What changes when a file does that is too large to be hashed each time, or one with its voxels beside it; of
    folders what their files say.
    """
    if path.is_dir():
        return [stamp_of(each) for each in sorted(path.iterdir()) if each.is_file()]
    try:
        stat = path.stat()
        return [str(path.resolve()), stat.st_size, stat.st_mtime_ns, *map(stamp_of, data_files(path))]
    except (OSError, ImageRefusal):
        return [str(path), 0, 0]


def sources(inputs: Sequence[str], output: Path) -> list[Path]:
    """What a case reads of its inputs, and of folders also what lies below; as they are said where they are gone."""
    try:
        return [*map(Path, inputs), *case_files(inputs, output)]
    except InputError:
        return [*map(Path, inputs)]


def renamed(request: Request, name_of: Callable[[str], str]) -> Request:
    """The request with other names of its files; names of structures and points stay."""

    def part_of(said: Any) -> Any:
        file, rest = file_of(said)
        return f"{new}{rest}" if file and Path(new := name_of(file)).exists() else said

    result: dict[str, Any] = {**request}
    for key in NAMING & set(result):
        result[key] = tuple(map(part_of, result[key]))
    if "inputs" in result:
        result["inputs"] = tuple(map(name_of, result["inputs"]))
    if "phases" in result:
        result["phases"] = tuple(tuple(map(name_of, group)) for group in result["phases"])
    if "robot" in result:
        result["robot"] = name_of(result["robot"])
    return request_of(result)


NAMING = {"targets", "entries", "lumens", "avoids", "ignored"}  # of which some may begin with a file's name


def file_of(said: Any) -> tuple[str, str]:
    """The file of "FILE" or "FILE:NAME", and what follows it; no file of other names and of numbers."""
    file, colon, name = said.partition(":") if isinstance(said, str) and not is_markups(said) else (said, "", "")
    is_file = isinstance(file, str) and (is_markups(file) or "/" in file)
    return (file, f"{colon}{name}") if is_file else ("", "")


def seen_from(folder: Path, name: str) -> str:
    """A file's name as it is in the working folder, of one that was said in another folder; with a slash in it."""
    if Path(name).is_absolute():
        return name
    result = Path(os.path.relpath(folder / name)).as_posix()
    return result if "/" in result else f"./{result}"


SCENARIO, BASES, PLACED, ENTRIES, ROBOT = "scenario.toml", "bases.csv", "placed.toml", "more_entries.csv", "robot.toml"
PLAN, SLICER = "plan", "slicer"


@dataclass
class Work:
    """One run on a case."""

    folder: Path
    request: Request
    record: Record
    stop: threading.Event
    progress: StageProgress
    note: Callable[[str], object]  # told a warning or what was recognised
    plan: Plan | None = None
    read: dict[str, Scenario] = field(default_factory=dict)

    def file(self, name: str) -> Path:
        """A file of the case."""
        return self.folder / name

    def scenario(self, name: str) -> Scenario:
        """The scenario of a file of the case, which is read once; files that it names may lie anywhere."""
        digest = digest_of(self.file(name))
        if digest not in self.read:
            self.read[digest] = load_scenario(self.file(name), allow_outside=True)
        return self.read[digest]

    def keep(self, name: str, scenario: Scenario) -> None:
        """Notes what reading a file of the case would give."""
        self.read[digest_of(self.file(name))] = scenario

    def end(self, step: CaseStep, sentence: str, chosen: int = 1) -> None:
        """Notes that a step's files are there, and what they were made from."""
        there = [name for name in (*step.files, *step.results) if self.file(name).exists()]
        digests = {name: digest_of(self.file(name)) for name in there}
        self.record.end(step.name, key_of(step.made_from(self)), digests, sentence, chosen)

    def state(self, *names: str) -> list[object]:
        """What changes when files of the case do, and images and meshes that scenarios name."""
        return [digest_of(self.file(name)) for name in names]


class CaseStep(ABC):
    """A step of a case."""

    name: ClassVar[str]
    files: ClassVar[tuple[str, ...]]  # that it writes and people may edit, in the case's folder
    results: ClassVar[tuple[str, ...]] = ()  # that it writes and nobody is expected to edit

    @abstractmethod
    def made_from(self, work: Work) -> object:
        """What its files depend on, for a hash."""

    @abstractmethod
    def make(self, work: Work) -> str:
        """Writes its files; returns what came of it in a sentence. Raises CtrplanError, with no file half written."""


def raw_files(scenario: Scenario) -> list[object]:
    """Stamps of images and meshes."""
    shapes = [shape for part in scenario.anatomy for shape in getattr(part.shape, "shapes", (part.shape,))]
    files = {str(file) for shape in shapes if (file := getattr(shape, "file", None))}
    return [stamp_of(Path(file)) for file in sorted(files)]


POSITION, TURN = ("x_mm", "y_mm", "z_mm"), ("qw", "qx", "qy", "qz")
TOLD = ("targets_reached", "worst_error_mm", "clearance_mm", "note")


def bases_text(poses: Sequence[BasePose]) -> str:
    """The file's content. Position and quaternion are read again, the rest is for whoever looks at it."""
    rows = []
    for pose in poses:
        position = np.round(pose.position_m * MM_PER_M, MM_DIGITS) + 0.0
        turn = np.round(BaseFrame(pose.position_m, pose.R).quaternion_wxyz, DIGITS) + 0.0
        rows.append([*position.tolist(), *turn.tolist(), *_told(pose)])
    return csv_text([*POSITION, *TURN, *TOLD], rows)


def read_bases(file: Path) -> list[BaseFrame]:
    """The poses in their order. Raises InputError for a table without the columns, and for what turns nothing."""
    table = CsvTable(str(file), "table of base poses")
    position, turn = np.split(table.columns([*POSITION, *TURN]), [len(POSITION)], axis=1)
    for k in range(len(position)):
        if np.abs(position[k]).max() > LONGEST_MM:
            raise table.fault(f"must lie from {-LONGEST_MM:g} to {LONGEST_MM:g} mm", k, "x_mm, y_mm, z_mm")
        if not abs(np.linalg.norm(turn[k]) - 1) <= NORM_TOLERANCE:
            raise table.fault(f"must have norm 1 within {NORM_TOLERANCE}", k, "qw, qx, qy, qz")
    rotations = Rotation.from_quat(np.roll(turn, -1, axis=1)).as_matrix()
    return [as_written(BaseFrame(*row)) for row in zip(position / MM_PER_M, rotations, strict=True)]


def _told(pose: BasePose) -> list[str]:
    worst = max((target.worst_m for target in pose.targets if target.best), default=math.inf)
    numbers = [f"{x * MM_PER_M:.3f}" if math.isfinite(x) else "" for x in (worst, pose.clearance_m)]
    note = pose.reason or ("the entry itself" if pose.is_own else "")
    return [f"{pose.reached} of {len(pose.targets)}", *numbers, note]
