"""What measured tips are off beyond the noise, and when other friction states are tried for it."""

from __future__ import annotations

from ctrplan.base.arrays import Array

GROSS = 4.0  # times the noise's variance, of a coordinate: beyond what chance does in one row of a hundred
SURPRISE = 3.0  # times the noise's variance unexplained, from which other friction states are tried


class Surprise:
    """Variances [m^2] of a coordinate, of steps that forget; and the pauses between tries, which grow."""

    def __init__(self, sigma_m: float, memory: int) -> None:
        """sigma_m: noise of a coordinate; memory: steps, after which one counts for 1/e."""
        self.noise_m2, self.unexplained_m2 = sigma_m**2, 0.0
        self.left_m2 = 0.0  # by the last step, where it is gross
        self._memory, self._kept = memory, 1 - 1 / memory
        self._wait, self._pause = 0, 0  # steps until other friction states are tried again, and after that

    @property
    def beyond_m2(self) -> float:
        """That a tip has besides what histories and slow errors spread, at least the noise of a row.

        What the histories are too coarse for can't be told from that.
        """
        return max(self.unexplained_m2, self.left_m2, self.noise_m2)

    def learn(self, surplus_m2: float) -> None:
        """From squares by which a step's tip is off beyond what was expected, its noise included."""
        beyond = surplus_m2 - self.noise_m2
        self.unexplained_m2 = max(0.0, self._kept * self.unexplained_m2 + (1 - self._kept) * beyond)

    def after(self, off_m: Array) -> None:
        """What is left (3,) [m] once the step's tip has been weighed."""
        left = float(off_m @ off_m) / 3
        self.left_m2 = left if left > GROSS * self.noise_m2 else 0.0

    def tries_others(self, besides: bool) -> bool:
        """Whether others are to be tried in this step; `besides`: another reason for it.

        Less and less often, where it is not friction that is missing.
        """
        if not (self.left_m2 or self.unexplained_m2 > SURPRISE * self.noise_m2 or besides):
            self._pause = self._wait = 0
            return False
        if self._wait > 0:
            self._wait -= 1
            return False
        self._wait, self._pause = self._pause, min(2 * self._pause + 1, self._memory)
        return True
