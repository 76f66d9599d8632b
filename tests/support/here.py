"""An executor that does a task at once in this process, and after so many ends as Ctrl-C would."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from ctrplan.studies.study.task import TaskNumbers


class Here:
    def __init__(self, most: float = float("inf")) -> None:
        self.most, self.done = most, 0

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        if self.done >= self.most:
            raise KeyboardInterrupt
        tasks = arguments[1] if len(arguments) > 1 and isinstance(arguments[1], (list, TaskNumbers)) else [0]
        self.done += len(tasks)
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future
