"""Shares of draws from the stated distribution, with Wilson intervals, and the solves that check them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.uncertainty.parameters import CI95, UncertainParameters
from ctrplan.uncertainty.worst_case import CHI95

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Registration

DRAWS, SOLVED, SEED = 10_000, 200, 23
DISTRIBUTION = (
    "parameters normal with the stated 95 % intervals, truncated where physics ends them, correlated as stated; "
    "registration normal in every direction; model_error_mm the 95th percentile of the length of a normal vector, "
    "another one at each target"
)


@dataclass(frozen=True)
class Chance:
    """How likely something is: the share of draws of the linearised model, with a 95 % interval of that share."""

    share: float
    low: float
    high: float
    solved_share: float  # of the draws that were solved
    solved_low: float
    solved_high: float

    @property
    def is_confirmed(self) -> bool:
        """Whether the solves allow the share of the linearised model."""
        return self.solved_low <= self.share <= self.solved_high

    @property
    def stated(self) -> float:
        """The share; that of the solves where they contradict it and are worse."""
        return self.solved_share if self.solved_low > self.share else self.share


def chance(linear: NDArray[np.bool_], solved: NDArray[np.bool_]) -> Chance:
    """Of events (M,) by the linearised model, and (R,) solved for the first of them."""
    return Chance(float(linear.mean()), *wilson(linear), float(solved.mean()), *wilson(solved))


def wilson(events: NDArray[np.bool_]) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    count, share, z2 = len(events), float(events.mean()), CI95**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = CI95 / (1 + z2 / count) * float(np.sqrt(share * (1 - share) / count + z2 / (4 * count**2)))
    # rounding must not shut out the ends
    return (0.0 if share == 0 else max(middle - half, 0.0)), (1.0 if share == 1 else min(middle + half, 1.0))


@dataclass(frozen=True, eq=False)
class Draws:
    """M robots, bases and unexplained errors drawn from the stated distribution; SI, robot frame."""

    offset: Array  # (M, P) of the parameters
    shift_m: Array  # (M, 3) of the base
    turn_rad: Array  # (M, 3) small rotation of the base
    unexplained_m: Array  # (M, 3)
    model_error_m: float  # 95th percentile of its length

    @classmethod
    def of(
        cls,
        parameters: UncertainParameters,
        registration: Registration,
        model_error_m: float,
        count: int = DRAWS,
        seed: int = SEED,
    ) -> Draws:
        """The same ones every time."""
        rng = np.random.default_rng(seed)
        offset = parameters.drawn(rng, count)
        scales = registration.position_sigma_m, registration.rotation_sigma_rad, model_error_m / CHI95
        shift, turn, unexplained = (scale * rng.standard_normal((count, 3)) for scale in scales)
        return cls(offset, shift, turn, unexplained, model_error_m)

    def elsewhere(self, number: int, seed: int = SEED) -> Draws:
        """The same robots and bases at another pose, whose unexplained error is another one."""
        rng = np.random.default_rng((seed, number))
        error = self.model_error_m / CHI95 * rng.standard_normal(self.unexplained_m.shape)
        return replace(self, unexplained_m=error)

    def rigid(self, point_m: Array) -> Array:
        """(M, 3) how base and unexplained errors displace a point (3,) [m]."""
        moved: Array = self.shift_m + np.cross(self.turn_rad, point_m) + self.unexplained_m
        return moved

    def turned(self, tangent: Array) -> Array:
        """(M, 3) how the base turns a direction (3,)."""
        moved: Array = np.cross(self.turn_rad, tangent)
        return moved
