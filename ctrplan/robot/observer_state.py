"""What an observer knows, as a value, and its estimate of the tip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.mechanics.core import Mechanics
    from ctrplan.mechanics.history import History, HistoryState

CARRIED = 0.95  # of the probability, by the histories between whose tips an interval extends
NORMAL_95 = 1.96  # standard deviations on both sides that hold 95 %


@dataclass(frozen=True, eq=False)
class TipEstimate:
    """Tips as the tracker would see them without its noise, at one place (3,) or at K of them (K, 3)."""

    position_m: Array  # mean
    low_m: Array  # of each coordinate, the ends of its 95 % interval
    high_m: Array
    tangent: Array  # unit vector, mean


@dataclass(frozen=True)
class ParameterEstimate:
    """A slow parameter, SI."""

    value: float
    sigma: float  # standard deviation


@dataclass(frozen=True, eq=False)
class Observed:
    """What an observer makes of one step."""

    expected: TipEstimate  # before the step's own measurement: one step ahead
    tip: TipEstimate  # after it
    friction: Array  # (n - 1,) circumferential friction state of each pair, mean
    histories: int  # that are still followed
    unexplained_m: float  # what measured tips are off beyond the stated noise, of a coordinate, rms of the last steps
    parameters: Mapping[str, ParameterEstimate]  # the slow ones
    started_anew: bool  # no history found an equilibrium on the way, all were begun again where the robot stands


def estimate(position_m: Array, tangent: Array, weight: Array, variance: Array) -> TipEstimate:
    """The estimate by H histories' tips (H, 3) or (H, K, 3), probabilities (H,), each coordinate known to a variance
    [m^2].

    The interval extends over the likeliest histories that carry 95 % together, and over 95 % of a normal error.
    """
    order = np.argsort(-weight, kind="stable")
    ordered = weight[order]
    carried = order[np.cumsum(ordered) - ordered < CARRIED]
    likely, beyond = position_m[carried], NORMAL_95 * np.sqrt(variance[carried])
    mean_tangent = _mean(weight, tangent)
    return TipEstimate(
        position_m=_mean(weight, position_m),
        low_m=(likely - beyond).min(axis=0),
        high_m=(likely + beyond).max(axis=0),
        tangent=mean_tangent / np.sqrt((mean_tangent * mean_tangent).sum(axis=-1, keepdims=True)),
    )


def _mean(weight: Array, vectors: Array) -> Array:
    """The mean of H vectors (H, 3) or of H rows of K of them (H, K, 3)."""
    mean: Array = (weight @ vectors.reshape(len(weight), -1)).reshape(vectors.shape[1:])
    return mean


SAME_RAD, SAME_M = 1e-6, 1e-8  # joints that differ by less are the same


@dataclass(frozen=True, eq=False)
class ObservedHistory:
    """One history that agrees with what was measured."""

    state: HistoryState
    accuracy: Accuracy  # mesh of the state
    phi: Array  # (n - 1,) circumferential friction state of each pair, averaged by normal force

    def history(self, mechanics: Mechanics, accuracy: Accuracy) -> History:
        """A history that goes on from here.

        On another mesh than that of the state friction starts uniform along each contact, at its average. Raises
        InputError for another robot.
        """
        from ctrplan.mechanics.history import History

        own = History(mechanics, accuracy=self.accuracy)
        own.restore(self.state)
        if accuracy == self.accuracy:
            return own
        other = History(mechanics, np.clip(self.phi, -1, 1), accuracy=accuracy)
        other.follow(self.state.theta_b[None], self.state.l_b[None])
        return other


@dataclass(frozen=True, eq=False)
class ObserverState:
    """Where a followed robot stands: H histories that agree with what was measured, and how well."""

    theta_b: Array  # (n,) [rad], collars
    l_b: Array  # (n,) [m]
    histories: tuple[ObservedHistory, ...]  # H, likeliest first
    weight: Array  # (H,) probabilities, of sum 1
    offset_m: Array  # (3,) what was measured is this much off the simulated tips
    parameters: Mapping[str, ParameterEstimate]  # slow ones; plans go by the robot that they are given

    def check(self, mechanics: Mechanics, theta_b: Array, l_b: Array) -> None:
        """Raises InputError unless it is of this robot, with collars at (n,) [rad], (n,) [m]."""
        try:
            self.histories[0].history(mechanics, self.histories[0].accuracy)
        except InputError:
            raise InputError("is of another robot", key="start_state") from None
        off = np.concatenate([np.abs(theta_b - self.theta_b) / SAME_RAD, np.abs(l_b - self.l_b) / SAME_M])
        if off.max() > 1:
            raise InputError("stands at other joints than the scenario's start", key="start_state")
