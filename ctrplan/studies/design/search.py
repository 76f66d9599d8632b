"""Searching for designs: proposals a batch at a time, whatever is missing done by an engine, rows kept as they come.

What was proposed follows from the seed and from the rows alone. A search that was ended asks the same again, finds the
answers in its folder, and goes on where there are none.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from ctrplan.planning.target_set.outlook import LESS_IS_BETTER
from ctrplan.studies.design.confirm import confirm
from ctrplan.studies.design.definition import Definition
from ctrplan.studies.design.front import Archive, Looked, judged
from ctrplan.studies.design.local_steps import descend
from ctrplan.studies.design.sampler import Sampler, check_installed
from ctrplan.studies.design.space import Design
from ctrplan.studies.study.engine import Engine
from ctrplan.studies.study.limited import unanswered
from ctrplan.studies.study.lines import Lines
from ctrplan.studies.study.run import Doing, Report, Where
from ctrplan.studies.study.store import Store
from ctrplan.studies.study.table import write_table
from ctrplan.studies.study.task import Task

SEARCH, LOCAL = "search", "local step"


@dataclass(frozen=True, eq=False)
class Found:
    """What a search left in its folder."""

    archive: Archive
    store: Store
    did: int  # designs looked at in this run
    interrupted: bool = False


def search(definition: Definition, folder: str | os.PathLike[str], where: Where, report: Report) -> Found:
    """Looks at designs until all trials and local steps are done, or Ctrl-C. Raises CtrplanError."""
    check_installed()
    store = Store(folder)
    store.open_for_work()
    own = {"file": os.path.relpath(definition.document.file or "design.toml", store.folder)}
    parts = [{**own, "content": definition.document.content}]
    store.write_definition({"name": definition.name, "version": definition.job.version, "parts": parts})
    interrupted, archive = False, Archive(definition.entry.objectives)
    looking = Looking(definition, store, archive, report)
    try:
        report(Doing("workers", 0, 1))
        with where.engine() as engine:
            looking.engine = engine
            _trials(definition, looking)
            best = sorted(archive.front, key=lambda looked: looked.numbers[judged(archive.objectives)])
            entry = definition.entry
            local = lambda designs: looking.look(designs, LOCAL, [])  # noqa: E731
            descend(definition.space, best[: entry.local.designs], entry.local.steps, entry.objectives, local)
            if entry.plans:
                confirm(definition, archive.front[: entry.plans], store, engine, report)
    except KeyboardInterrupt:
        interrupted = True
    try:
        looking.write_keys()
        write_table(store)
    finally:
        store.close()
    return Found(archive, store, looking.did, interrupted)


def _trials(definition: Definition, looking: Looking) -> None:
    """All trials of the sampler, a batch at a time."""
    entry, archive = definition.entry, looking.archive
    less = [LESS_IS_BETTER[name] for name in entry.objectives]
    sampler = Sampler(definition.space.names, less, entry.sampler, entry.seed, looking.store.folder)
    for first in range(0, entry.trials, entry.together):
        asked = sampler.ask(min(entry.together, entry.trials - first))
        front = [archive.values(looked) for looked in archive.front] if entry.prune else []
        looked = looking.look([definition.space.design(shares) for _, shares in asked], SEARCH, front)
        for (trial, _), one in zip(asked, looked, strict=True):
            sampler.tell(trial, list(archive.values(one).values()) if one.is_done else None)


class Looking:
    """Looks at designs: what the folder has no row of is done by an engine."""

    engine: Engine

    def __init__(self, definition: Definition, store: Store, archive: Archive, report: Report) -> None:
        """Nothing is done yet."""
        self.definition, self.store, self.archive, self.report = definition, store, archive, report
        self.keys: dict[str, int] = {}  # of all tasks, in their order
        self.did, self.begun = 0, time.monotonic()
        entry = definition.entry
        self.count = entry.trials + entry.local.designs * entry.local.steps

    def look(self, designs: Sequence[Design], stage: str, front: list[dict[str, float]]) -> list[Looked]:
        """The rows of designs, in their order; they join the archive."""
        tasks = [self._task(design, stage, front) for design in designs]
        missing = {
            task.key: (task, design) for task, design in zip(tasks, designs, strict=True) if self._is_missing(task)
        }
        self._do(missing.values())
        found = [Looked(design, self._row(task)) for design, task in zip(designs, tasks, strict=True)]
        for looked in found:
            self.archive.add(looked)
        self.write_keys()
        return found

    def write_keys(self) -> None:
        """The order of all tasks so far, which tables have their rows in."""
        self.store.write_keys(self.keys)

    def _task(self, design: Design, stage: str, front: list[dict[str, float]]) -> Task:
        task = self.definition.task(0, design, stage, front)
        index = self.keys.setdefault(task.key, len(self.keys))
        return self.definition.task(index, design, stage, front)

    def _do(self, missing: Iterable[tuple[Task, Design]]) -> None:
        able = []
        for task, design in missing:
            if sentence := self._refusal(design):
                self.store.add(Lines.of([unanswered(task, "no answer", sentence)]))
            else:
                able.append([task])
        for lines in self.engine.rows(self.definition.content, iter(able), None) if able else ():
            self.store.add(lines)
            self.did += len(lines)
            done = min(len(self.archive.all) + self.did % len(able), self.count)
            self.report(Doing("designs", done, self.count, self._left_s(), self.engine.note))

    def _refusal(self, design: Design) -> str:
        """Why a design can't be made; empty where it can."""
        strain, most = self.definition.space.strain(design), self.definition.entry.made.most_strain
        if strain <= most:
            return ""
        return (
            f"can't be made: setting its precurvature strains a tube by {100 * strain:.1f} %, {100 * most:g} % at most."
        )

    def _left_s(self) -> float | None:
        left = self.count - len(self.archive.all)
        return (time.monotonic() - self.begun) / self.did * left if self.did else None

    def _is_missing(self, task: Task) -> bool:
        key = bytes.fromhex(task.key)
        return key not in self.store.offsets or self.store.failed.get(key) == "lost"

    def _row(self, task: Task) -> dict[str, Any]:
        with open(self.store.folder / "rows.jsonl", "rb") as file:
            file.seek(self.store.offsets[bytes.fromhex(task.key)])
            row: dict[str, Any] = json.loads(file.readline())
            return {**row, "index": task.index}
