"""Where the tasks of a study are done: an engine is given chunks of tasks, its workers give rows back, whatever
happens.

Only so many chunks are handed out at a time that nobody waits, so that memory does not grow with the study.
"""

from __future__ import annotations

import math
import os
import pickle
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from functools import lru_cache
from typing import Any

import numpy as np

from ctrplan.base.catalogue import code_version
from ctrplan.base.long_work import one_core
from ctrplan.errors import CtrplanError, InputError, NoAnswerError
from ctrplan.storage.toml_document import Document, TomlTable, chosen
from ctrplan.studies.child_process import ChildEnded, ChildExecutor, in_child
from ctrplan.studies.study.store import Lines
from ctrplan.studies.study.task import CATALOGUE, Job, Status, Task, TaskKind, TaskNumbers, TaskRow

Chunk = Sequence[Task] | TaskNumbers
"""Tasks that a worker gets at a time."""


class VersionError(InputError):
    """A worker has another version of the package than whoever sent it tasks."""


def check_version(theirs: str) -> None:
    """Raises VersionError, with both, unless this process has the version of whoever sends tasks."""
    if theirs != code_version():
        differ = f"has ctrplan {code_version()}, the study is run by {theirs}: install the same"
        raise VersionError(f"the worker {worker_name()} {differ}")


def do_chunk(content: bytes, chunk: Chunk) -> Lines:
    """The rows of a chunk of a job's tasks, as `do_tasks` has them."""
    check_version(_job(content).version)
    return Lines.of(do_tasks(content, tasks_of(content, chunk)))


def tasks_of(content: bytes, chunk: Chunk) -> Sequence[Task]:
    """The tasks of a chunk, also where only their numbers were sent."""
    if not isinstance(chunk, TaskNumbers):
        return chunk
    tasks = _job(content).tasks
    assert tasks is not None
    return chunk.of(tasks)


def do_tasks(content: bytes, tasks: Sequence[Task]) -> list[TaskRow]:
    """The rows of tasks of a job, on one thread. Raises VersionError; all else that goes wrong stands in the rows."""
    job = _job(content)
    check_version(job.version)
    kind = _kind(content)
    prepare(content)
    rows, where, last = [], worker_name(), (time.process_time(), time.monotonic())
    with one_core():
        for task, result in kind.rows(tasks, job):
            ended = (time.process_time(), time.monotonic())
            rows.append(_row(job, task, result, where, (ended[0] - last[0], ended[1] - last[1])))
            last = ended
    return rows


def prepare(content: bytes) -> None:
    """Does what comes before a job's first task and is none of its time: slow imports, the files."""
    _ = _job(content).sources.here


def kind_of(job: Job) -> TaskKind:
    """What is done with every task. Raises InputError."""
    document = Document.of({"task": dict(job.task)}, "study")
    return chosen(TomlTable(document, ("task",)), "kind", CATALOGUE, TaskKind)


@lru_cache(maxsize=4)
def _job(content: bytes) -> Job:
    job: Job = pickle.loads(content)
    return job


@lru_cache(maxsize=4)
def _kind(content: bytes) -> TaskKind:
    return kind_of(_job(content))


def _row(
    job: Job, task: Task, result: Mapping[str, Any] | Exception, where: str, took_s: tuple[float, float]
) -> TaskRow:
    status: Status = "done"
    reason = ""
    numbers: Mapping[str, Any] = {}
    if isinstance(result, Exception):
        status, reason = _status(result), _sentence(result, job)
        numbers = getattr(result, "numbers", {})
    else:
        numbers = result
    return TaskRow(
        key=task.key,
        index=task.index,
        inputs=task.inputs,
        status=status,
        reason=reason,
        numbers={name: _plain(value) for name, value in numbers.items() if not job.numbers or name in job.numbers},
        seconds=took_s[0],
        elapsed_s=took_s[1],
        worker=where,
        overrides=task.overrides,
        files={name: job.sources.named(data) for name, data in getattr(result, "files", {}).items()},
    )


def _status(error: Exception) -> Status:
    if isinstance(error, NoAnswerError):
        return "no answer"
    if isinstance(error, InputError):
        return "refused"
    return "lost" if isinstance(error.__cause__ or error, (MemoryError, ImportError)) else "failed"  # of this worker


def _sentence(error: Exception, job: Job) -> str:
    """What went wrong, about the files as they are called where the study was begun."""
    if isinstance(error, CtrplanError):
        return job.sources.with_original_paths(str(error))
    if isinstance(error, MemoryError):
        return "there is not enough memory for this."
    return job.sources.with_original_paths(f"{type(error).__name__}: {' '.join(str(error).split())}")


def _plain(value: Any) -> Any:
    plain = value.item() if isinstance(value, np.generic) else value
    return plain if not isinstance(plain, float) or math.isfinite(plain) or math.isinf(plain) else math.nan


def worker_name() -> str:
    """Machine and process."""
    return f"{socket.gethostname()}:{os.getpid()}"


def do_limited(content: bytes, chunk: Chunk, limit_s: float) -> Lines:
    """Rows of tasks, each of which may take `limit_s`; one that did not live to answer has a row that says so."""
    rows: list[TaskRow] = []
    for task in tasks_of(content, chunk):
        try:
            in_child(prepare, content)
            rows += in_child(do_tasks, content, [task], limit_s=limit_s)
        except TimeoutError:
            rows.append(unanswered(task, "timed out", f"took longer than the limit of {limit_s:g} s.", limit_s))
        except ChildEnded as error:
            rows.append(unanswered(task, "lost", f"{error}."))
    return Lines.of(rows)


def unanswered(task: Task, status: Status, sentence: str, elapsed_s: float = 0.0) -> TaskRow:
    """The row of a task that gave no answer."""
    return TaskRow(task.key, task.index, task.inputs, status, sentence, overrides=task.overrides, elapsed_s=elapsed_s)


Chunks = Iterator[Chunk]
AHEAD = 2  # chunks for each worker: one that it does, one that is there when it is done


class Engine(ABC):
    """Workers, from `with` until its end."""

    note: str = ""  # where they can be watched

    @property
    @abstractmethod
    def workers(self) -> int:
        """How many there are now."""

    def prepare(self, content: bytes) -> None:  # noqa: B027 (where it is none of its business)
        """Lets workers that were started for this study do what comes before a first task, all at the same time."""

    @abstractmethod
    def rows(self, content: bytes, chunks: Chunks, limit_s: float | None) -> Iterator[Lines]:
        """Rows of all chunks in any order. `content` is the pickled job; raises CtrplanError where nobody can go on."""

    def __enter__(self) -> Engine:
        """The engine at work."""
        return self

    def __exit__(self, *_: object) -> None:  # noqa: B027 (some have nothing to end)
        """Ends what it started."""


class ExecutorEngine(Engine):
    """Any executor of the interface of concurrent.futures."""

    def __init__(self, executor: Executor, workers: int) -> None:
        """workers: how many tasks it does at a time."""
        self.executor, self._workers = executor, workers

    @property
    def workers(self) -> int:
        """How many there were said to be."""
        return self._workers

    def rows(self, content: bytes, chunks: Chunks, limit_s: float | None) -> Iterator[Lines]:
        """Rows as chunks are done. Raises InputError where the executor takes no tasks."""
        given: dict[Future[Lines], Chunk] = {}
        try:
            while True:
                for chunk in chunks:
                    given[self._submitted(content, chunk, limit_s)] = chunk
                    if len(given) >= AHEAD * self.workers:
                        break
                if not given:
                    return
                for future in wait(given, return_when=FIRST_COMPLETED).done:
                    yield answer(future, content, given.pop(future))
        finally:
            for future in given:
                future.cancel()

    def _submitted(self, content: bytes, chunk: Chunk, limit_s: float | None) -> Future[Lines]:
        try:
            if limit_s is None:
                return self.executor.submit(do_chunk, content, chunk)
            return self.executor.submit(do_limited, content, chunk, limit_s)
        except RuntimeError as error:  # of all executors of concurrent.futures
            raise InputError(f"takes no tasks ({error})", key="executor", value=self.executor) from error


def answer(future: Any, content: bytes, chunk: Chunk) -> Lines:
    """The rows of a chunk, also where whoever did it gave none. Raises VersionError, InputError without ctrplan."""
    try:
        lines: Lines = future.result()
        return lines
    except VersionError:
        raise
    except ModuleNotFoundError as error:
        raise InputError(f"the workers lack the module {error.name}: install ctrplan where they run") from error
    except Exception as error:
        words = " ".join(str(error).split()).rstrip(".")
        sentence = f"{words}." if isinstance(error, ChildEnded) else f"{type(error).__name__}: {words}."
        if type(error).__name__ == "KilledWorker":  # dask's, which speaks of its workers' logs
            sentence = "every process that did it ended."
        return Lines.of([unanswered(task, "lost", sentence) for task in tasks_of(content, chunk)])


class PoolEngine(ExecutorEngine):
    """An engine of as many processes as there are cores, or as stated."""

    def __init__(self, workers: int | None = None) -> None:
        """Starts nothing before there are tasks."""
        executor = ChildExecutor(workers)
        super().__init__(executor, executor.workers)

    def __exit__(self, *error: object) -> None:
        """Ends the processes."""
        self.executor.__exit__(*error)  # type: ignore[arg-type]
