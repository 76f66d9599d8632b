"""How many cores one piece of work may use: all of them, unless many pieces run side by side."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

VARIABLE = "CTRPLAN_THREADS"
MOST = 1024
_lock = threading.Lock()
_side_by_side = 0  # pieces of work that this process does in that way now


def cores() -> int:
    """Threads to start for work that can be shared: CTRPLAN_THREADS, else one for each core."""
    return _limit() or os.cpu_count() or 1


def core_threads(asked: int) -> int:
    """What the compiled core is told where `asked` is asked of us: 0 there means every core."""
    return int(asked) or _limit()


@contextmanager
def one_core() -> Iterator[None]:
    """Meanwhile this process shares no work among threads: others beside it have the other cores."""
    global _side_by_side
    with _lock:
        _side_by_side += 1
    try:
        yield
    finally:
        with _lock:
            _side_by_side -= 1


def _limit() -> int:
    """The most threads that work may be shared among; 0 where there is no limit."""
    if _side_by_side:
        return 1
    text = os.environ.get(VARIABLE, "")
    return int(text) if text.isdecimal() and 0 < int(text) <= MOST else 0
