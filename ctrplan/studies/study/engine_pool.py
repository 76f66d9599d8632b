"""Processes of this machine, without any further package: threads that each have a child process do the tasks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from ctrplan.base.cores import cores
from ctrplan.studies.study.child import close_children, in_child
from ctrplan.studies.study.engine import Chunks, Engine, ExecutorEngine
from ctrplan.studies.study.task import Row


class PoolEngine(Engine):
    """As many processes as there are cores, or as are asked for."""

    def __init__(self, workers: int | None = None) -> None:
        """Starts nothing before there are tasks."""
        self.threads = ThreadPoolExecutor(workers or cores())
        self._workers = workers or cores()

    @property
    def workers(self) -> int:
        """How many processes."""
        return self._workers

    def rows(self, content: bytes, chunks: Chunks, limit_s: float | None) -> Iterator[Sequence[Row]]:
        """Rows as chunks are done."""
        return ExecutorEngine(self.threads, self._workers, in_child, in_child).rows(content, chunks, limit_s)

    def __exit__(self, *_: Any) -> None:
        """Ends the processes."""
        self.threads.shutdown(wait=False, cancel_futures=True)
        close_children()
        self.threads.shutdown()
