"""Where tasks are done: an engine is given chunks of tasks, and gives their rows back as they come.

Only so many chunks are handed out at a time that nobody waits, so that memory does not grow with the study.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any

from ctrplan.errors import InputError
from ctrplan.studies.child_process import ChildEnded, ChildExecutor
from ctrplan.studies.study.store import Lines
from ctrplan.studies.study.worker import Chunk, VersionError, do_chunk, do_limited, tasks_of, unanswered

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
        return Lines.of([unanswered(task, "lost", sentence) for task in tasks_of(content, chunk)])


class PoolEngine(ExecutorEngine):
    """As many processes as there are cores, or as are asked for."""

    def __init__(self, workers: int | None = None) -> None:
        """Starts nothing before there are tasks."""
        executor = ChildExecutor(workers)
        super().__init__(executor, executor.workers)

    def __exit__(self, *error: object) -> None:
        """Ends the processes."""
        self.executor.__exit__(*error)  # type: ignore[arg-type]
