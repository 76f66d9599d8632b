"""What an observer knows, as a value: the friction states that agree with what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.robot.observer.estimate import ParameterEstimate

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.mechanics.core import Mechanics
    from ctrplan.mechanics.history import History, HistoryState

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
