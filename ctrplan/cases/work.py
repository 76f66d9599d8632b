"""What the steps of a case share: its folder, what was asked for, scenarios that were read, whom to tell."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from ctrplan.base.progress import StageProgress
from ctrplan.cases.record import Record, digest_of, key_of, stamp_of
from ctrplan.cases.request import Request
from ctrplan.files.scenario_file import load_scenario
from ctrplan.planning.plan import Plan
from ctrplan.planning.scenario import Scenario

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
        """That of a file of the case, which is read once; files that it names may lie anywhere."""
        digest = digest_of(self.file(name))
        if digest not in self.read:
            self.read[digest] = load_scenario(self.file(name), allow_outside=True)
        return self.read[digest]

    def keep(self, name: str, scenario: Scenario) -> None:
        """Notes what reading a file of the case would give."""
        self.read[digest_of(self.file(name))] = scenario

    def end(self, step: Step, sentence: str, chosen: int = 1) -> None:
        """Notes that a step's files are there, and what they were made from."""
        there = [name for name in (*step.files, *step.results) if self.file(name).exists()]
        digests = {name: digest_of(self.file(name)) for name in there}
        self.record.end(step.name, key_of(step.made_from(self)), digests, sentence, chosen)

    def state(self, *names: str) -> list[object]:
        """What changes when files of the case do, and images and meshes that scenarios name."""
        return [digest_of(self.file(name)) for name in names]


class Step(ABC):
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
