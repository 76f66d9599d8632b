"""What long work tells whoever waits for it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], object]
"""Is told the finished share, 0 to 1."""
StageProgress = Callable[[str, float], object]
"""Is told what is being done and its finished share, 0 to 1."""


def part_of(progress: Progress | None, part: int, count: int) -> Progress:
    """What the work on part `part` (from 0) of `count` equal ones tells, so that the share of the whole only rises."""
    return lambda share: progress((part + share) / count) if progress else None
