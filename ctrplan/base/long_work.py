"""Work that takes long: how many cores it may use, how it is interrupted, what it tells, and when its budget is
spent.

BIT* draws a batch by rejection: where hardly any state can lead to a better path, as between a start and a goal close
to each other, a batch asks for millions of heuristics before it looks at its termination condition. An answer of
infinite cost makes that worse, an exception ends it: OMPL hands it through all its loops to whoever called `solve`.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from types import FrameType
from typing import Literal

VARIABLE = "CTRPLAN_THREADS"
MOST_THREADS = 1024  # or processes; beyond any machine of today
_lock = threading.Lock()
_side_by_side = 0  # pieces of work that this process does in that way now


def cores() -> int:
    """Threads to start for work that can be shared: CTRPLAN_THREADS, else one for each core."""
    return _limit() or os.cpu_count() or 1


def core_threads(requested: int) -> int:
    """Number of threads for the compiled core, which takes 0 for every core, from a number `requested` of a caller."""
    return int(requested) or _limit()


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
    return int(text) if text.isdecimal() and 0 < int(text) <= MOST_THREADS else 0


INTERRUPTED = 130  # exit code


@contextmanager
def interrupt_event(given: threading.Event | None = None) -> Iterator[threading.Event]:
    """An event that Ctrl-C sets instead of raising; `given`, if somebody else already takes care of it.

    Outside the main thread, where signals cannot be handled, the event is simply never set.
    """
    event = given or threading.Event()
    if given is not None or threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = signal.signal(signal.SIGINT, lambda *_: event.set())
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, previous)


@contextmanager
def interrupts_noticed() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, also where the import of a compiled module made another error of it."""
    pressed = False

    def press(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        pressed = True
        signal.default_int_handler(number, frame)

    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # somebody else takes care
        yield
        return
    signal.signal(signal.SIGINT, press)
    try:
        yield
    except Exception as error:
        if pressed:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


Progress = Callable[[float], object]
"""Is told the finished share, 0 to 1."""
StageProgress = Callable[[str, float], object]
"""Is told what is being done and its finished share, 0 to 1."""


def part_of(progress: Progress | None, part: int, count: int) -> Progress:
    """What the work on part `part` (from 0) of `count` equal ones tells, so that the share of the whole only rises."""
    return lambda share: progress((part + share) / count) if progress else None


SearchEnd = Literal["count", "time", "interruption", "completion"]
# Nanoseconds counted for what a search does, about what it takes on one core of 3 GHz.
SHAPE_NS = 200_000  # a shape in equilibrium with clearance and friction; a state takes one and one for every corner
ROOM_NS = 15_000  # a zero-clearance shape and its clearance
EDGE_NS = 120  # a motion of a roadmap, each time that its shortest path is sought
HEURISTIC_NS = 4_000  # a lower bound of a motion's cost
ASKED_NS = 20_000  # a question of the planner, whatever the answer
# A budget of counted seconds may take so many real ones, a few at least, however slow the machine or dear the robot.
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


class Laps:
    """Seconds by the clock that came one after the other, by what took them."""

    def __init__(self) -> None:
        """The first lap begins."""
        self.seconds: dict[str, float] = {}
        self._began_s = time.monotonic()

    def end(self, name: str) -> None:
        """What came since the lap before was `name`."""
        now = time.monotonic()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._began_s
        self._began_s = now


@dataclass(eq=False)
class SearchClock:
    """Seconds since a search began, real ones if `timed`, else those counted by its meter.

    Counted ones end, too, when the budget took REAL_PER_COUNTED times as long by the clock: what is not counted takes
    time. A part of the search may take as long as it likes: one dear certificate in its midst is no end.
    """

    meter: WorkMeter
    timed: bool
    budget_s: float  # of the whole search
    ran_out: bool = False
    outlasted: bool = False  # whether the budget of counted seconds took too many real ones
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
        """Whether that time has come by the clock; for counted seconds, whether the budget took too many real ones.

        Unlike what is counted this may be asked in the middle of work that is shared by threads.
        """
        real_s = time.monotonic() - self._really_began_s
        if self.timed:
            return real_s >= until_s
        self.outlasted |= real_s >= max(REAL_PER_COUNTED * self.budget_s, LEAST_REAL_S)
        return self.outlasted

    @property
    def name(self) -> SearchEnd:
        """What ends a search that has run out."""
        return "time" if self.timed or self.outlasted else "count"

    def _reading(self) -> float:
        return time.monotonic() if self.timed else self.meter.spent_ns * 1e-9


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
        """Asks as `ask`, every CHEAP_QUESTIONS times; counted, so that a search ends at one question everywhere."""
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
