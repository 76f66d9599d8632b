"""Names the steps of a diagnosis to whoever watches, and stops between them when asked to."""

from __future__ import annotations

import threading
from dataclasses import dataclass

from ctrplan.base.progress import StageProgress

HELD_OUT_SHARE = 0.95  # of the work done when the held-out set is asked


class Interrupted(Exception):
    """Ctrl-C between two fits."""


@dataclass(eq=False)
class Teller:
    """Names the steps to whoever watches, and stops between them when asked to."""

    progress: StageProgress | None
    interrupted: threading.Event | None
    share: float = 0.05

    def pause(self) -> None:
        """Where a run may stop."""
        if self.interrupted is not None and self.interrupted.is_set():
            raise Interrupted

    def __call__(self, step: str) -> None:
        """A step begins."""
        self.pause()
        self.share += 0.25 * (HELD_OUT_SHARE - self.share)  # how many steps there will be is not known
        if self.progress:
            self.progress(step, self.share)
