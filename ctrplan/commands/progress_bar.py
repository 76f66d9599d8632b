"""Progress on a terminal: the search with its best cost, then the certificate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ctrplan.planning.planner import Progress


class ProgressBar:
    """One bar per stage of planning, gone from the terminal when the stage is over."""

    def __init__(self, *, quiet: bool) -> None:
        self.quiet = quiet
        self.bar: Any = None
        self.stage = ""

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()

    def update(self, progress: Progress) -> None:
        """Moves the bar to a stage's fraction."""
        if self.quiet:
            return
        if progress.stage != self.stage:
            self._begin(progress.stage)
        self.bar.n = progress.fraction
        if progress.best_cost_mm is not None:
            self.bar.set_postfix_str(f"best cost {progress.best_cost_mm:.1f} mm", refresh=False)
        self.bar.update(0)

    def _begin(self, stage: str) -> None:
        from tqdm import tqdm

        if self.bar is not None:
            self.bar.close()
        self.stage = stage
        shown = "{desc}|{bar}| {percentage:3.0f} % {postfix}"
        self.bar = tqdm(total=1.0, desc=f"{stage:11}", bar_format=shown, leave=False)
