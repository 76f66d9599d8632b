"""What a search has spent: by the clock, or by work counted, so that the same seed gives the same plan everywhere."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Literal

SearchEnd = Literal["count", "time", "interruption", "completion"]
# Nanoseconds counted for what a search does, about what it takes on one core of 3 GHz.
SHAPE_NS = 200_000  # a shape in equilibrium with clearance and friction; a state takes one and one for every corner
ROOM_NS = 40_000  # a zero-clearance shape and its clearance
LOOKED_UP_NS = 20_000  # a state looked up in a bound field
HEURISTIC_NS = 4_000  # a lower bound of a motion's cost
ASKED_NS = 20_000  # a question of the planner, whatever the answer
# Counted seconds may take so many real ones, and a few at least, however slow the machine or dear the robot.
REAL_PER_COUNTED, LEAST_REAL_S = 10.0, 10.0


_ASIDE: ContextVar[WorkMeter | None] = ContextVar("aside", default=None)


@contextmanager
def counted_aside() -> Iterator[WorkMeter]:
    """Within, in this context, all work is counted by a meter of its own: what is done ahead counts when asked for."""
    meter = WorkMeter()
    token = _ASIDE.set(meter)
    try:
        yield meter
    finally:
        _ASIDE.reset(token)


class WorkMeter:
    """Counts work [ns]; whole numbers, so that the order in which threads add does not matter."""

    def __init__(self) -> None:
        """Begins at nothing spent."""
        self._lock = threading.Lock()
        self.spent_ns = 0

    def add(self, amount_ns: int) -> None:
        """Counts work done."""
        meter = _ASIDE.get() or self
        with meter._lock:
            meter.spent_ns += amount_ns


@dataclass(eq=False)
class SearchClock:
    """Seconds since a search began, real ones if `timed`, else those counted by its meter.

    Counted ones end, too, when they take REAL_PER_COUNTED times as long by the clock: what is not counted takes time.
    """

    meter: WorkMeter
    timed: bool
    ran_out: bool = False
    outlasted: bool = False  # whether counted seconds took too many real ones
    _began_s: float = field(default=0.0)
    _really_began_s: float = field(default=0.0)

    def __post_init__(self) -> None:
        """Starts the clock."""
        self._began_s, self._really_began_s = self._reading(), time.monotonic()

    def now(self) -> float:
        """Seconds since the clock was made."""
        return self._reading() - self._began_s

    def is_past(self, until_s: float) -> bool:
        """Whether that time has come; remembered, as it ends a search."""
        over = self.is_late(until_s) or self.now() >= until_s
        self.ran_out |= over
        return over

    def is_late(self, until_s: float) -> bool:
        """Whether that time has come by the clock; for counted seconds, whether they take too many real ones.

        Unlike what is counted this may be asked in the middle of work that is shared by threads.
        """
        real_s = time.monotonic() - self._really_began_s
        if self.timed:
            return real_s >= until_s
        self.outlasted |= real_s >= max(REAL_PER_COUNTED * until_s, LEAST_REAL_S)
        return self.outlasted

    @property
    def name(self) -> SearchEnd:
        """What ends a search that has run out."""
        return "time" if self.timed or self.outlasted else "count"

    def _reading(self) -> float:
        return time.monotonic() if self.timed else self.meter.spent_ns * 1e-9
