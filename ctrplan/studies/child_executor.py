"""Processes of this machine as an executor, without any further package: threads that each have a child process."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from ctrplan.base.cores import cores
from ctrplan.studies.child_process import close_children, in_child

T = TypeVar("T")


class ChildExecutor(ThreadPoolExecutor):
    """As many processes as cores, or as are asked for; a child that dies takes its own task with it and no other's."""

    def __init__(self, workers: int | None = None) -> None:
        """Starts a process with its first task."""
        super().__init__(workers or cores())
        self.workers = workers or cores()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """A call of a function of some module; `limit_s` among the keywords is the time that it may take."""
        return super().submit(in_child, fn, *args, **kwargs)

    def __exit__(self, *_: object) -> None:
        """Ends the processes, whatever they are doing."""
        self.shutdown(wait=False, cancel_futures=True)
        close_children()
        self.shutdown()
