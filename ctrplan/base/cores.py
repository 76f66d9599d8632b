"""How many cores one piece of work may use: all of them, unless many pieces run side by side."""

from __future__ import annotations

import os

VARIABLE = "CTRPLAN_THREADS"
_most: int | None = None


def cores() -> int:
    """Threads to start for work that can be shared: those that `use_cores` or CTRPLAN_THREADS allows, else all."""
    return _most or _asked() or os.cpu_count() or 1


def core_threads(asked: int) -> int:
    """What the compiled core is told where `asked` is asked of us: 0 there means every core."""
    return int(asked) or _most or _asked() or 0


def use_cores(most: int) -> None:
    """From now on no work of this process is shared among more than `most` threads."""
    global _most
    _most = most


def _asked() -> int | None:
    text = os.environ.get(VARIABLE, "")
    return int(text) if text.isdecimal() and 0 < int(text) <= 1024 else None
