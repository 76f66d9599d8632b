"""Colour and progress bars on a terminal."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ctrplan.planning.search.stage_search import Progress

AMBER, PLAIN = "\033[33m", "\033[0m"


def amber(text: str) -> str:
    """The text in amber where a person reads standard output; as it is in files and pipes, and under NO_COLOR."""
    shown = sys.stdout is not None and sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    return f"{AMBER}{text}{PLAIN}" if shown else text


class ProgressBar:
    """One bar per stage, gone from the terminal when the stage is over; none for stages shorter than `patience_s`."""

    def __init__(self, *, quiet: bool, patience_s: float = 0.0) -> None:
        """quiet: show nothing at all."""
        self.quiet = quiet
        self.patience_s = patience_s
        self.bar: Any = None
        self.stage = ""

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
        if stage != self.stage:
            self._begin(stage)
        self.bar.n = fraction
        if note:
            self.bar.set_postfix_str(note, refresh=False)
        self.bar.update(0)

    def _begin(self, stage: str) -> None:
        from tqdm import tqdm

        if self.bar is not None:
            self.bar.close()
        self.stage = stage
        shown = "{desc}|{bar}| {percentage:3.0f} % {postfix}"
        self.bar = tqdm(total=1.0, desc=f"{stage:11}", bar_format=shown, leave=False, delay=self.patience_s)
