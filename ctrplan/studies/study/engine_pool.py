"""Processes of this machine, without any further package."""

from __future__ import annotations

from ctrplan.studies.child_executor import ChildExecutor
from ctrplan.studies.study.engine import ExecutorEngine


class PoolEngine(ExecutorEngine):
    """As many processes as there are cores, or as are asked for."""

    def __init__(self, workers: int | None = None) -> None:
        """Starts nothing before there are tasks."""
        executor = ChildExecutor(workers)
        super().__init__(executor, executor.workers)

    def __exit__(self, *error: object) -> None:
        """Ends the processes."""
        self.executor.__exit__(*error)  # type: ignore[arg-type]
