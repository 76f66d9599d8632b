"""What a search of designs is: its space, its targets, the files that travel with the tasks, and the front of
designs.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ctrplan.base.arrays import Array
from ctrplan.base.package import __version__
from ctrplan.files.design_file import DesignEntry
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.toml_document import Document
from ctrplan.studies.design.space import Design, DesignSpace, toml
from ctrplan.studies.study.kinds.target_set import TARGET_S
from ctrplan.studies.study.points import target_points
from ctrplan.studies.study.sources import Sources
from ctrplan.studies.study.task import KEY_DIGITS, Job, Task
from ctrplan.studies.target_set import cost, dominates

Row = dict[str, Any]  # of the folder's rows.jsonl


@dataclass(frozen=True, eq=False)
class EvaluatedDesign:
    """A design and the row that came of it."""

    design: Design
    row: Row

    @property
    def numbers(self) -> dict[str, Any]:
        """What is known of it."""
        numbers: dict[str, Any] = self.row["numbers"]
        return numbers

    @property
    def is_done(self) -> bool:
        """Whether it has all numbers: it was neither given up nor refused."""
        return bool(self.row["status"] == "done")


@dataclass(eq=False)
class Archive:
    """All designs in the order in which they were proposed."""

    objectives: Sequence[str]
    all: list[EvaluatedDesign] = field(default_factory=list)

    def add(self, looked: EvaluatedDesign) -> None:
        """One more."""
        self.all.append(looked)

    def values(self, looked: EvaluatedDesign) -> dict[str, float]:
        """The objectives of a design that is done."""
        return {name: float(looked.numbers[name]) for name in self.objectives}

    @property
    def front(self) -> list[EvaluatedDesign]:
        """Designs that no other dominates, each once, the best by the first objective first."""
        done = {looked.design.key: looked for looked in reversed(self.all) if looked.is_done}
        known = [(looked, self.values(looked)) for looked in done.values()]
        kept = [looked for looked, own in known if not any(dominates(other, own) for _, other in known)]
        return sorted(kept, key=lambda looked: self._rank(looked))

    def _rank(self, looked: EvaluatedDesign) -> tuple[float, ...]:
        own = self.values(looked)
        return (*(cost(name, own[name]) for name in self.objectives), float(looked.row["index"]))


def judged(objectives: Iterable[str]) -> str:
    """The error that local steps lead down: the robust one where it is asked for."""
    return "robust_mm" if "robust_mm" in objectives else "error_mm"


@dataclass(frozen=True, eq=False)
class DesignDefinition:
    """A search."""

    entry: DesignEntry
    document: Document
    scenario: Scenario  # as in its file, with what every design has otherwise
    space: DesignSpace
    points_mm: Array  # (T, 3) targets
    job: Job

    @property
    def name(self) -> str:
        """The name in the file, else the file's own."""
        return self.entry.name or Path(self.document.file or "design").stem

    @property
    def content(self) -> bytes:
        """What every worker is given once."""
        return pickle.dumps(self.job)

    @property
    def expected_s(self) -> float:
        """Seconds of one core that the search takes at most, roughly."""
        local = self.entry.local.designs * self.entry.local.steps
        return (self.entry.trials + local) * len(self.points_mm) * TARGET_S

    @cached_property
    def base(self) -> str:
        """Hash of what all designs share."""
        content = {"version": __version__, "task": dict(self.job.task), "start": self.job.sources.digest(self.job.main)}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def task(self, index: int, design: Design, stage: str, front: list[dict[str, float]]) -> Task:
        """What a worker does with a design; `front`: designs that a better one has to match, else it is given up."""
        sides = [
            {"name": side.name, "low": low, "high": high, "is_tolerance": side.is_tolerance}
            for side, low, high in self.space.sides(design)
        ]
        overrides = self.space.overrides(design)
        settings: dict[str, Any] = {"seed": self.entry.seed, "sides": sides, "front": front}
        text = json.dumps([self.base, overrides, settings], sort_keys=True)
        key = hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]
        return Task(index, key, {"stage": stage, **self.space.inputs(design)}, tuple(overrides), settings)

    def goals(self, looked: EvaluatedDesign) -> list[dict[str, Any]]:
        """[goal] for each target: its tip, and the joints that the design was judged by where it is reached."""
        result = json.loads(looked.numbers.get("joints", "[]")) or [None] * len(self.points_mm)
        tips = [{"tip_mm": point, "tolerance_mm": self.job.task["tolerance_mm"]} for point in self.points_mm.tolist()]
        return [tip | ({"joints": own} if own else {}) for tip, own in zip(tips, result, strict=True)]

    def tolerance_costs(self, looked: EvaluatedDesign) -> list[tuple[str, float, str, float]]:
        """Name, half width, unit and cost [mm] of every tolerance of a design, the costliest first."""
        results = [
            (side.name, side.width, side.unit, abs(float(looked.numbers[f"slope.{side.name}"])))
            for side, _, _ in self.space.sides(looked.design)
            if side.is_tolerance
        ]
        return sorted(results, key=lambda row: -row[3])


def defined(entry: DesignEntry, document: Document, allow_outside: bool) -> DesignDefinition:
    """The search of a file's entries. Raises InputError."""
    folder = Path(document.file or ".").parent
    main = folder / entry.scenario
    if not main.is_file():
        raise document.fault("is not a file that exists", "scenario")
    overrides = [f"{key}={toml(value)}" for key, value in entry.set.items()]
    scenario = load_scenario(main, overrides, allow_outside=allow_outside)
    named = [main.parent / value for value in entry.set.values() if isinstance(value, str)]
    sources = Sources.of([main, *(file for file in named if file.is_file())], folder)
    points = target_points(entry.targets, scenario, document, folder)
    task = {
        "kind": "target_set",
        "points_mm": points.tolist(),
        "tolerance_mm": entry.targets.tolerance_mm or scenario.goal.tolerance_m * 1e3,
        "starts": entry.starts,
        "unreached_mm": entry.unreached_mm,
    }
    job = Job(
        sources=sources,
        main=sources.name(main),
        is_robot=False,
        task=task,
        study_folder=sources.name(folder),
        allow_outside=allow_outside,
    )
    definition = DesignDefinition(entry, document, scenario, DesignSpace(entry, scenario.robot.n), points, job)
    _check(definition, os.fspath(main))
    return definition


def _check(definition: DesignDefinition, main: str) -> None:
    """Raises InputError for keys that there are not: designs at both ends of all ranges are read."""
    count = len(definition.space.names)
    for share in (0.0, 1.0, 0.5):
        overrides = definition.space.overrides(definition.space.design([share] * count))
        load_scenario(main, overrides, allow_outside=definition.job.allow_outside)
