"""`ctrplan.TubeDesign`: a search for designs from its file or content, and what came of it."""

from __future__ import annotations

import json
import math
import os
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ctrplan.base.package import shown
from ctrplan.files.robot_file import load_robot, write_robot
from ctrplan.storage.output_folder import write_atomically
from ctrplan.storage.toml_document import Document
from ctrplan.studies.design.search import PLANS, search
from ctrplan.studies.design.space import Archive, DesignDefinition, EvaluatedDesign, defined
from ctrplan.studies.study.axes import goal_overrides
from ctrplan.studies.study.sources import ROBOT_PREFIX
from ctrplan.studies.study.study import Report, Where, refuse_longer_than_a_week
from ctrplan.studies.study.study_definition import FromFile
from ctrplan.studies.study.table import StudyTable, load_study

FRONT, ROBOTS = "front.json", "robots"


class TubeDesign(FromFile, DesignDefinition):
    """A search over what can be made, for a set of targets in an anatomy; made by `TubeDesign.read` or `.of`."""

    file_kind = "design"

    @classmethod
    def made_from(cls, document: Document, allow_outside: bool) -> DesignDefinition:
        """The search's definition."""
        return defined(document, allow_outside)

    def run(
        self,
        folder: str | os.PathLike[str],
        *,
        executor: Executor | None = None,
        workers: int | None = None,
        scheduler: str | None = None,
        scheduler_file: str | None = None,
        yes: bool = False,
        progress: Report | None = None,
    ) -> TubeDesigns:
        """Looks at designs, those aside that the folder has rows of, and writes the front. Raises CtrplanError.

        The same seed gives the same designs on any number of workers and after any number of interruptions. Raises
        InputError for a search of more than a week unless `yes`.
        """
        where = Where(executor, workers, scheduler, scheduler_file)
        refuse_longer_than_a_week(self.entry.trials, self.expected_s, "trials", where, yes, self.document.file)
        result = search(self, folder, where, progress or (lambda _: None))
        made = TubeDesigns(self, Path(folder), result.archive, result.did, result.interrupted)
        made.write()
        return made


@shown
@dataclass(frozen=True, eq=False)
class TubeDesigns:
    """What a search found."""

    search: TubeDesign
    folder: Path
    archive: Archive
    did: int  # designs looked at in this run
    interrupted: bool

    @property
    def table(self) -> StudyTable:
        """All designs, a row each, those too that were given up."""
        return load_study(self.folder)

    @property
    def plans(self) -> StudyTable | None:
        """Plans of the first designs of the front to every target, a row each; None where none were asked for."""
        return load_study(self.folder / PLANS) if self.search.entry.plans and not self.interrupted else None

    @property
    def front(self) -> list[EvaluatedDesign]:
        """Designs that no other is better than, the best by the first objective first."""
        return self.archive.front

    @property
    def counts(self) -> tuple[int, int, int]:
        """Designs that have all numbers, that were given up for the front, that can't be made or reach nothing."""
        done = sum(looked.is_done for looked in self.archive.all)
        given_up = sum("of the front" in looked.row["reason"] for looked in self.archive.all)
        return done, given_up, len(self.archive.all) - done - given_up

    def entries(self) -> list[dict[str, Any]]:
        """The front as plain values: number, objectives, choices, --set, cost of each tolerance [mm]."""
        return [self._entry(k, looked) for k, looked in enumerate(self.front, start=1)]

    def write(self) -> None:
        """front.json and a robot file for each design of the front; the folder's other files are there already."""
        write_atomically(self.folder / FRONT, json.dumps(self.entries(), indent=1, ensure_ascii=False) + "\n")
        robots = self.folder / ROBOTS
        robots.mkdir(exist_ok=True)
        for old in robots.glob("*.toml"):
            old.unlink()
        for k, looked in enumerate(self.front, start=1):
            own = [text for text in looked.row["overrides"] if text.startswith(ROBOT_PREFIX)]
            robot = load_robot(self.search.scenario.robot.path or "", [text.removeprefix(ROBOT_PREFIX) for text in own])
            name = {"name": f"{self.search.name}, design {k}"}
            write_robot(robots / f"{k:02d}.toml", {**dict(robot.content), **name})

    def _entry(self, k: int, looked: EvaluatedDesign) -> dict[str, Any]:
        costs = self.search.tolerance_costs(looked)
        choices = {name: value for name, value in looked.row["inputs"].items() if name != "stage"}
        known = {name: value for name, value in looked.numbers.items() if not name.startswith(("slope.", "joints"))}
        numbers = {name: None if value in (math.inf, -math.inf) else value for name, value in known.items()}
        return {
            "number": k,
            "row": looked.row["index"],
            "stage": looked.row["inputs"]["stage"],
            **numbers,
            "choices": choices,
            "set": looked.row["overrides"],
            "goals": [{**goal, "set": goal_overrides(goal)[0]} for goal in self.search.goals(looked)],
            "tolerances": [
                {"name": name, "half_width": width, "unit": unit, "costs_mm": cost} for name, width, unit, cost in costs
            ],
        }
