"""Many bounds at once, in chunks: progress between them, and anyone's executor to run them on."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import fields
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.mechanics.shapes import Bounds

CHUNK = 256  # configurations of three tubes per call into the core, which spreads them over threads: half a second
FEWEST = 16  # which still keep every thread busy
TASK = 64  # configurations per task of an executor: long against sending it, short enough to share out evenly


class ManyBounds(Protocol):
    """What `Mechanics` answers for many configurations."""

    def bound_many(self, theta_b: Array, l_b: Array, *, accuracy: Accuracy, threads: int) -> Bounds:
        """Bounds of (K, n) base rotations [rad] and translations [m]."""


def rows_in_a_chunk(n: int, accuracy: Accuracy) -> int:
    """Configurations of n tubes between two reports of progress, at which Ctrl-C is noticed as well."""
    corners = max(1.0, 2.0 ** (n - 3) * n / 3)  # four at a time; a node has 5 n - 4 unknowns
    finer = {"search": 1, "certificate": 4, "exact": 16}[accuracy]
    return max(FEWEST, int(CHUNK / (corners * finer)))


def bounds_in_chunks(
    solve: Callable[[Array, Array], Bounds], theta_b: Array, l_b: Array, rows: int, progress: Progress | None
) -> Bounds:
    """`solve` for (K, n), (K, n), `rows` after `rows` in the calling thread."""
    parts = []
    for chunk in chunks(len(theta_b), rows):
        parts.append(solve(theta_b[chunk], l_b[chunk]))
        if progress:
            progress(min(1.0, chunk.stop / max(len(theta_b), 1)))
    return join(parts)


def bounds_on_executor(
    executor: Executor,
    mechanics: ManyBounds,
    theta_b: Array,
    l_b: Array,
    accuracy: Accuracy,
    threads: int,
    progress: Progress | None,
) -> Bounds:
    """`mechanics.bound_many` for (K, n), (K, n) as tasks on an executor, each on `threads` threads (0: one)."""
    content = pickle.dumps(mechanics)
    tasks = [(content, theta_b[chunk], l_b[chunk], accuracy, max(threads, 1)) for chunk in chunks(len(theta_b), TASK)]
    return join(run(executor, _solve_chunk, tasks, progress))


def run(
    executor: Executor, work: Callable[..., Bounds], tasks: Sequence[Sequence[Any]], progress: Progress | None
) -> list[Bounds]:
    """work(*task) of every task, in order. Uses nothing but `submit`, `result` and `cancel`, which all executors have.

    What is not done yet is called off when a task or `progress` raises, Ctrl-C included. Raises InputError where the
    executor takes no tasks, because it was shut down or its workers died.
    """
    futures: list[Any] = []
    results: list[Bounds] = []
    try:
        for task in tasks:
            futures.append(_submitted(executor, work, task))
        for done, future in enumerate(futures, start=1):
            results.append(future.result())
            if progress:
                progress(done / len(futures))
    finally:
        for future in futures[len(results) :]:
            future.cancel()
    return results


def _submitted(executor: Executor, work: Callable[..., Bounds], task: Sequence[Any]) -> Any:
    try:
        return executor.submit(work, *task)
    except RuntimeError as error:  # of all executors of concurrent.futures
        raise InputError(f"takes no tasks ({error})", key="executor", value=executor) from error


def join(parts: Sequence[Bounds]) -> Bounds:
    """One table of all rows."""
    if len(parts) == 1:
        return parts[0]
    columns = ([getattr(part, field.name) for part in parts] for field in fields(parts[0]))
    return type(parts[0])(*map(np.concatenate, columns))


def chunks(count: int, size: int) -> list[slice]:
    """Slices of `size` that cover `count` rows; at least one, which is empty if there are none."""
    return [slice(first, min(first + size, count)) for first in range(0, max(count, 1), size)]


def _solve_chunk(content: bytes, theta_b: Array, l_b: Array, accuracy: Accuracy, threads: int) -> Bounds:
    return _rebuilt(content).bound_many(theta_b, l_b, accuracy=accuracy, threads=threads)


@lru_cache(maxsize=4)
def _rebuilt(content: bytes) -> ManyBounds:
    """The model in this process, built once from the numbers it was given: the workspaces of its solvers are reused."""
    mechanics: ManyBounds = pickle.loads(content)
    return mechanics
