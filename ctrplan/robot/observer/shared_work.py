"""Work on several histories of one observer, shared among threads: the core works without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from ctrplan.base.cores import cores

Item = TypeVar("Item")
Done = TypeVar("Done")


class SharedWork:
    """Threads that live as long as their observer, for a step is too short to start some."""

    def __init__(self) -> None:
        """Without any until there is something to share."""
        self._pool: ThreadPoolExecutor | None = None
        self._threads = 0

    def each(self, work: Callable[[Item], Done], items: Sequence[Item]) -> list[Done]:
        """work(item) of every item, in order. Items are independent, so that threads change no answer."""
        threads = cores()
        if threads < 2 or len(items) < 2:
            return [work(item) for item in items]
        if self._pool is None or self._threads != threads:
            self._pool, self._threads = ThreadPoolExecutor(threads, "observer"), threads
        return list(self._pool.map(work, items))

    def parts(self, count: int) -> list[slice]:
        """`count` rows as one slice for each thread."""
        shares = max(1, min(count, cores()))
        ends = [count * k // shares for k in range(shares + 1)]
        return [slice(*pair) for pair in zip(ends[:-1], ends[1:], strict=True)]
