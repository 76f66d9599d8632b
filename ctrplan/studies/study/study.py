"""`ctrplan.Study`: a study from its file or content; what is missing in its folder is done by an engine, rows are
kept.
"""

from __future__ import annotations

import math
import os
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any

from ctrplan.base.long_work import cores
from ctrplan.errors import InputError
from ctrplan.storage.toml_document import Document
from ctrplan.studies.study.engine import Engine, ExecutorEngine, PoolEngine
from ctrplan.studies.study.engine_dask import DaskEngine, is_installed
from ctrplan.studies.study.store import Store
from ctrplan.studies.study.study_definition import FromFile, StudyDefinition, defined
from ctrplan.studies.study.table import StudyTable, extreme_tasks, load_study, write_table
from ctrplan.studies.study.task import Task, TaskNumbers

MOST_TASKS = 1_000_000  # without being asked twice
MOST_DAYS = 7.0
CHUNK_S = 1.0  # of one worker, for up to 500 workers
SCHEDULED_S = 1e-3  # of the scheduler for a chunk, as dask states it: 1,000 workers with chunks of 1 s keep it busy
MOST_IN_CHUNK = 4096
SHARES = 2  # chunks for each worker, at least, of what is left: none is left with the last long one
TOLD_EVERY = 20_000  # tasks that are looked for
LEAST_S = 0.05  # of chunks that become smaller towards the end
PLAN_FILES = ("plan.json", "trajectory.csv", "report.html", "plan.png")


@dataclass(frozen=True)
class Doing:
    """How far a study is."""

    stage: str
    done: int
    count: int
    left_s: float | None = None  # seconds that are left, once that can be told
    note: str = ""

    @property
    def share(self) -> float:
        """0 to 1."""
        return self.done / max(self.count, 1)


Report = Callable[[Doing], object]


@dataclass(frozen=True, eq=False)
class Where:
    """Who does the tasks: an executor, a cluster, or processes of this machine."""

    executor: Executor | None = None
    workers: int | None = None
    scheduler: str | None = None
    scheduler_file: str | None = None

    @property
    def expected(self) -> int:
        """Workers that can be counted on before anything is started."""
        return self.workers or cores()

    @contextmanager
    def engine(self) -> Iterator[Engine]:
        """The engine at work. Raises CtrplanError where there can be none."""
        if self.executor is not None:
            with ExecutorEngine(self.executor, self.expected) as engine:
                yield engine
        elif self.scheduler or self.scheduler_file or is_installed():
            with DaskEngine(self.workers, scheduler=self.scheduler, scheduler_file=self.scheduler_file) as engine:
                yield engine
        else:
            with PoolEngine(self.workers) as engine:
                yield engine


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run left in the folder."""

    store: Store
    file: Path  # of the table
    count: int  # tasks of the study
    did: int  # of them in this run
    interrupted: bool = False

    @property
    def table(self) -> StudyTable:
        """All rows that there are."""
        return load_study(self.store.folder)


def run_study(
    study: StudyDefinition,
    folder: str | os.PathLike[str],
    where: Where,
    *,
    add: bool = False,
    yes: bool = False,
    progress: Report | None = None,
) -> Outcome:
    """Does those tasks of a study that its folder has no rows of, and writes the table.

    With `add`, what the folder's study had stays in the table, although this one does not have it. Ctrl-C ends it with
    what there is. Raises InputError for a study that takes more than a week unless `yes`, a folder that another process
    works on, workers with another version; CtrplanError for a full disk.
    """
    report = progress or (lambda _: None)
    refuse_endless(study, where, yes)
    store = Store(folder)
    store.open_for_work()
    try:
        studies = _with_earlier(study, store, add)
        missing = {part: TaskNumbers.none() for part in studies}
        count = store.write_keys(_counted(studies, store, missing, report))
        did, interrupted = _do(studies, missing, store, where, report)
        return Outcome(store, write_table(store), count, did, interrupted)
    finally:
        store.close()


def refuse_endless(study: StudyDefinition, where: Where, yes: bool) -> None:
    """Raises InputError, with the time that it would take, for a study that nobody means to wait for."""
    refuse_longer_than_a_week(study.count, study.count * study.task_s, "tasks", where, yes, study.document.file)


def refuse_longer_than_a_week(count: int, core_s: float, what: str, where: Where, yes: bool, file: str | None) -> None:
    """Raises InputError for so many seconds of one core, or more than a million pieces of work, unless `yes`."""
    expected_s = core_s / where.expected
    if not yes and (count > MOST_TASKS or expected_s > MOST_DAYS * 86400):
        rule = (
            f"{count:,} {what} would take about {in_words(expected_s)} on {where.expected} workers: "
            "--yes does them all the same"
        )
        raise InputError(rule, file=file)


def in_words(seconds: float) -> str:
    """A duration, to one digit or two."""
    for unit, size in (("years", 365.25 * 86400), ("days", 86400.0), ("hours", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:,.0f} {unit}" if seconds >= 10 * size else f"{seconds / size:.1f} {unit}"
    return f"{max(seconds, 0):.0f} s"


def _with_earlier(study: StudyDefinition, store: Store, add: bool) -> list[StudyDefinition]:
    """The studies whose tasks the table has, in their order; study.json says so."""
    folder = os.path.abspath(store.folder)
    file = os.path.abspath(study.document.file or "study.toml")
    own = {"file": os.path.relpath(file, folder), "content": study.document.content}
    known = (store.definition() or {"parts": []})["parts"]
    parts = known if own in known else [*known, own] if add else [own]
    store.write_definition({"name": study.name, "version": study.job.version, "parts": parts})
    earlier = [
        study if part == own else _again(part, folder, study.job.allow_outside)  # the file may have changed
        for part in parts
    ]
    return earlier


def _again(part: Mapping[str, Any], folder: str, allow_outside: bool) -> StudyDefinition:
    place = Path(folder) / str(part["file"])
    content = part["content"]
    if not isinstance(content, dict):
        raise InputError("says nothing of a study", file=str(Path(folder) / "study.json"))
    document = Document.of(content, "study", str(place.resolve()))
    return defined(document, allow_outside)


def _tasks(studies: Sequence[StudyDefinition]) -> Iterator[tuple[StudyDefinition, int, Task]]:
    """All tasks, each once, numbered in their order; and which of a study's list each is."""
    seen: set[str] = set()
    index = 0
    for study in studies:
        for k in range(study.count):
            task = study.tasks[k]
            if len(studies) > 1:
                if task.key in seen:
                    continue
                seen.add(task.key)
            yield study, k, replace(task, index=index) if task.index != index else task
            index += 1


def _do(
    studies: Sequence[StudyDefinition],
    missing: Mapping[StudyDefinition, TaskNumbers],
    store: Store,
    where: Where,
    report: Report,
) -> tuple[int, bool]:
    """Does what is missing; returns how many tasks that were, and whether Ctrl-C ended it."""
    did = 0
    some = [study for study in studies if missing[study]]
    extreme = [study for study in studies if study.entry.keep.plans == "extremes"]
    if not some and not extreme:
        return 0, False
    report(Doing("workers", 0, 1))
    try:
        with where.engine() as engine:
            for study in some:
                engine.prepare(study.content)
            for did in _done({study: missing[study] for study in some}, store, engine, report):  # noqa: B007
                pass
            for study in extreme:
                _keep_extremes(study, studies, store, engine, report)
    except KeyboardInterrupt:
        return did, True
    return did, False


def _done(
    missing: Mapping[StudyDefinition, TaskNumbers], store: Store, engine: Engine, report: Report
) -> Iterator[int]:
    """Does what is missing, and says after every chunk how many tasks are done."""
    did, count, began = 0, sum(map(len, missing.values())), time.monotonic()
    report(Doing("tasks", 0, count, None, engine.note))
    if not engine.workers:
        report(Doing("waiting for a worker to join", 0, 1))
    for study, tasks in missing.items():
        chunks = tasks.chunks(_sizes(study, len(tasks), engine.workers))
        for lines in engine.rows(study.content, chunks, study.kind.time_limit_s):
            store.add(lines)
            did += len(lines)
            left_s = (time.monotonic() - began) * (count - did) / did
            report(Doing("tasks", did, count, left_s, engine.note))
            yield did


def _counted(
    studies: Sequence[StudyDefinition], store: Store, missing: Mapping[StudyDefinition, TaskNumbers], report: Report
) -> Iterator[str]:
    """Keys of all tasks; meanwhile those that are missing are noted for each study."""
    most = sum(study.count for study in studies)
    for study, k, task in _tasks(studies):
        if task.index % TOLD_EVERY == TOLD_EVERY - 1:  # a million takes half a minute
            report(Doing("looking for what is missing", task.index, most))
        if _is_missing(study, task, store):
            missing[study].add(k, task.index, bytes.fromhex(task.key))
        yield task.key


def _is_missing(study: StudyDefinition, task: Task, store: Store) -> bool:
    """Whether there is no row that could stay: none, or one of a task that nobody lived to answer."""
    key = bytes.fromhex(task.key)
    if key not in store.offsets:
        return True
    status = store.failed.get(key, "done")
    if status == "timed out":
        return (study.kind.time_limit_s or math.inf) > store.elapsed_s[key]
    if status == "done" and study.job.keep:
        return not all((store.plan_folder(task.index) / name).is_file() for name in study.job.keep)
    return status == "lost"


def _sizes(study: StudyDefinition, count: int, workers: int) -> Iterable[int]:
    """Sizes of chunks: so many tasks at a time that neither their worker nor the scheduler notices the hand-over."""
    in_chunks = study.kind.together and study.kind.time_limit_s is None
    return chunk_sizes(study.task_s, count, max(workers, 1)) if in_chunks else repeat(1)


def chunk_sizes(task_s: float, count: int, workers: int) -> Iterator[int]:
    """Sizes of all chunks of `count` tasks in their order: smaller at the end, where workers would wait otherwise."""
    first, least = chunk_size(task_s, count, workers), math.ceil(LEAST_S / task_s)
    while count > 0:
        size = min(first, max(least, chunk_size(task_s, count, workers)), count)
        yield size
        count -= size


def chunk_size(task_s: float, count: int, workers: int) -> int:
    """How many of `count` tasks a worker gets at a time."""
    chunk_s = max(CHUNK_S, 2 * SCHEDULED_S * workers)
    return int(min(MOST_IN_CHUNK, max(1.0, chunk_s / task_s), math.ceil(count / (SHARES * workers))))


def _keep_extremes(
    study: StudyDefinition, studies: Sequence[StudyDefinition], store: Store, engine: Engine, report: Report
) -> None:
    """The plans of the best and the worst row, made again and kept."""
    wanted = extreme_tasks(study, [task for owner, _, task in _tasks(studies) if owner is study], store, PLAN_FILES)
    content = pickle.dumps(replace(study.job, keep=PLAN_FILES))
    for done, lines in enumerate(engine.rows(content, ([task] for task in wanted), study.kind.time_limit_s), start=1):
        store.add(lines)
        report(Doing("plans", done, len(wanted), None, engine.note))


class Study(FromFile, StudyDefinition):
    """Independent tasks, one for every combination of what is varied; made by `Study.read` or `Study.of`."""

    file_kind = "study"
    load = staticmethod(load_study)

    @classmethod
    def made_from(cls, document: Document, allow_outside: bool) -> StudyDefinition:
        """The study's definition."""
        return defined(document, allow_outside)

    def run(
        self,
        folder: str | os.PathLike[str],
        *,
        executor: Executor | None = None,
        workers: int | None = None,
        scheduler: str | None = None,
        scheduler_file: str | None = None,
        add: bool = False,
        yes: bool = False,
        progress: Report | None = None,
    ) -> StudyTable:
        """Does what is missing in the folder, and returns the table; see `run.run_study`. Raises CtrplanError."""
        where = Where(executor, workers, scheduler, scheduler_file)
        return run_study(self, folder, where, add=add, yes=yes, progress=progress).table

    def show(self, table: StudyTable, height: int = 700) -> Any:
        """The report of a table of this study as a page within a notebook; its `save` writes it."""
        import ctrplan  # pages are of a package above, and stand in the public names

        return ctrplan.show(self, table=table, height=height)
