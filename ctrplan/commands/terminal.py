"""What commands print: warnings, tables, numbers of JSON, colour and progress bars."""

from __future__ import annotations

import math
import os
import shlex
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ctrplan.planning.search.stage_search import Progress

AMBER, PLAIN = "\033[33m", "\033[0m"
EVERY_S = 10.0  # between lines of progress where no bar can be
PATIENCE_S = 1.0  # before a progress bar of what mostly takes less shows up


def warn(sentences: Iterable[str]) -> None:
    """Prints warnings on standard error."""
    for sentence in sentences:
        print(f"ctrplan: warning: {sentence}", file=sys.stderr)


def typed(name: object) -> str:
    """A file's name as it is typed in a shell."""
    return shlex.quote(str(name))


def tell_next(command: str) -> None:
    """Prints what to do with a result, below it."""
    print(f"next: {command}")


@contextmanager
def telling(sentence: str) -> Iterator[None]:
    """Prints on standard error what a block does that has no progress to show, if it takes longer than EVERY_S."""
    timer = threading.Timer(EVERY_S, print, (f"ctrplan: {sentence}; Ctrl-C ends it",), {"file": sys.stderr})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def finite(value: float) -> float | None:
    """The value for JSON, which has no infinite numbers and no NaN."""
    return value if math.isfinite(value) else None


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """A line for each row, its cells aligned on the right; a cell beyond those of the first row ends its line."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=False)]
        lines.append("  ".join([*cells, *row[len(widths) :]]).rstrip())
    return lines


def amber(text: str) -> str:
    """The text in amber where a person reads standard output; as it is in files and pipes, and under NO_COLOR."""
    shown = sys.stdout is not None and sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    return f"{AMBER}{text}{PLAIN}" if shown else text


class ProgressBar:
    """One bar per stage, gone from the terminal when the stage is over; none for stages shorter than `patience_s`.

    Where standard error is no terminal it says instead, in a line every EVERY_S, how far the stage is.
    """

    def __init__(self, *, quiet: bool = False, patience_s: float = 0.0) -> None:
        """quiet: show nothing at all."""
        self.quiet = quiet or sys.stderr is None
        self.in_lines = not self.quiet and not sys.stderr.isatty()
        self.patience_s = patience_s
        self.bar: Any = None
        self.stage = ""
        self.said_s = self.begun_s = time.monotonic()

    def __enter__(self) -> ProgressBar:
        """The bar itself, empty until the first stage."""
        return self

    def __exit__(self, *_: object) -> None:
        """Takes the last bar off the terminal, also after an error."""
        if self.bar is not None:
            self.bar.close()

    def update(self, progress: Progress) -> None:
        """Moves the bar to where a planner is."""
        cost_mm = progress.best_cost_mm
        self.show(progress.stage, progress.fraction, "" if cost_mm is None else f"best cost {cost_mm:.1f} mm")

    def show(self, stage: str, fraction: float, note: str = "") -> None:
        """Moves the bar to a stage's fraction."""
        if self.quiet:
            return
        if self.in_lines:
            self._say(stage, fraction, note)
            return
        if stage != self.stage:
            self._begin(stage)
        self.bar.n = fraction
        if note:
            self.bar.set_postfix_str(note, refresh=False)
        self.bar.update(0)

    def _say(self, stage: str, fraction: float, note: str) -> None:
        """A line, unless the last one was a moment ago."""
        now = time.monotonic()
        if now - self.said_s < EVERY_S:
            return
        self.said_s = now
        more = f", {note}" if note else ""
        print(f"ctrplan: {stage} {100 * fraction:.0f} %{more}, {now - self.begun_s:.0f} s", file=sys.stderr, flush=True)

    def _begin(self, stage: str) -> None:
        from tqdm import tqdm

        if self.bar is not None:
            self.bar.close()
        self.stage = stage
        shown = "{desc}|{bar}| {percentage:3.0f} % {postfix}"
        self.bar = tqdm(total=1.0, desc=f"{stage:11}", bar_format=shown, leave=False, delay=self.patience_s)
