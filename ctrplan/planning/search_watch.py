"""Ends a search from within: loops, above all OMPL's, may run for minutes without asking whether to stop.

BIT* draws a batch by rejection: where hardly any state can lead to a better path, as between a start and a goal close
to each other, a batch asks for millions of heuristics before it looks at its termination condition. An answer of
infinite cost makes that worse, an exception ends it: OMPL hands it through all its loops to whoever called `solve`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

CHEAP_QUESTIONS = 16  # for each look at the clock: a heuristic takes little longer than such a look


class SearchOver(Exception):  # noqa: N818, it is no error
    """The search is to end, now."""


class SearchWatch:
    """Asked before everything that takes time, which it ends by an exception; silent while nothing is watched."""

    def __init__(self) -> None:
        """Watches nothing."""
        self._is_over: Callable[[], bool] | None = None
        self._cheap = 0

    def ask(self) -> None:
        """Raises SearchOver once the search is over."""
        if self._is_over is not None and self._is_over():
            raise SearchOver

    def ask_cheaply(self) -> None:
        """Likewise, every CHEAP_QUESTIONS times; counted, so that a search ends at the same question everywhere."""
        self._cheap += 1
        if self._cheap % CHEAP_QUESTIONS == 0:
            self.ask()

    @contextmanager
    def until(self, is_over: Callable[[], bool]) -> Iterator[None]:
        """Watches until the block is left."""
        before, self._is_over = self._is_over, is_over
        try:
            yield
        finally:
            self._is_over = before
