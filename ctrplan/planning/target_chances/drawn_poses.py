"""Poses of the tip of drawn robots in every friction state: by the linearised model, and solved for the first of them.

What the solves find beyond first order is in all draws: a mean of 0.03 mm of it made stated chances 4 points too small
(docs/log/planning.md, coverage of uncertain parameters).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.planning.target_chances.aim import Aim, Misses
from ctrplan.planning.target_chances.beyond_first_order import BeyondFirstOrder, repeated
from ctrplan.planning.target_chances.simulated_poses import SimulatedPoses
from ctrplan.planning.uncertainty.chance import SOLVED, Draws
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.tip_slopes import TipSlopes, poses_at, tip_slopes


@dataclass(frozen=True, eq=False)
class DrawnPoses:
    """Of M draws at W places, joint values at which the tip is looked at, in S friction states."""

    parameters: UncertainParameters
    theta: Array  # (W, n) commanded
    l: Array  # (W, n)  # noqa: E741 (as in the equations)
    slopes: TipSlopes  # (W, S)
    draws: Draws
    beyond: BeyondFirstOrder  # (R, W, S, 6) of the first R draws

    @classmethod
    def of(cls, parameters: UncertainParameters, draws: Draws, theta: Array, l: Array) -> DrawnPoses:  # noqa: E741
        """At commanded collars theta, l (W, n)."""
        slopes, offsets = tip_slopes(parameters, theta, l), draws.offset[:SOLVED]
        linear = slopes.pose + np.einsum("wscp,mp->mwsc", slopes.pose_by, offsets)
        solved = np.stack([poses_at(parameters, offset, theta, l) for offset in offsets])
        beyond = BeyondFirstOrder.of(offsets / parameters.sigma, solved - linear)
        return cls(parameters, theta, l, slopes, draws, beyond)

    def any_friction(self, aim: Aim, places: NDArray[np.int_], draws: Draws) -> tuple[Misses, Misses]:
        """In the worst friction state of all places: of all draws, and of those that were solved.

        `places` are those of one target, its end last; `draws` has the same robots.
        """
        found, own = list[Misses](), list[Misses]()
        for w, is_end in _ends(places):
            at = self.slopes.pose[w]
            for into, moved in ((found, self._moved(w)), (own, self._solved(w))):
                states = [_judged(aim, at[s] + moved[:, s], at[s], draws, is_end) for s in range(len(at))]
                into.append(Misses.worst(states))
        return Misses.worst(found), Misses.worst(own)

    def by_history(
        self, aim: Aim, places: NDArray[np.int_], draws: Draws, simulated: SimulatedPoses
    ) -> tuple[Misses, Misses]:
        """With friction as simulated, likewise."""
        found, own = list[Misses](), list[Misses]()
        for w, is_end in _ends(places):
            for into, moved in ((found, self._moved(w)), (own, self._solved(w))):
                pose = simulated.started(w, len(moved)) + moved.mean(axis=1)
                pose += repeated(simulated.beyond[:, w], len(moved)) if len(simulated.beyond) else 0.0
                into.append(_judged(aim, pose, simulated.middle(w), draws, is_end))
        return Misses.worst(found), Misses.worst(own)

    @property
    def solved(self) -> Array:
        """(R, W, 6) how parameters move poses on the mean over friction states, of the draws that were solved."""
        found: Array = np.stack([self._solved(w).mean(axis=1) for w in range(len(self.theta))], axis=1)
        return found

    def _moved(self, w: int) -> Array:
        """(M, S, 6) by parameters."""
        return self._displaced(w, self.draws.offset)

    def _solved(self, w: int) -> Array:
        """(R, S, 6) the same, of the draws that were solved."""
        return self._displaced(w, self.draws.offset[: len(self.beyond.rest)])

    def _displaced(self, w: int, offset: Array) -> Array:
        linear: Array = np.einsum("scp,mp->msc", self.slopes.pose_by[w], offset)
        return linear + self.beyond.at(offset / self.parameters.sigma, w)


def _ends(places: NDArray[np.int_]) -> Iterator[tuple[int, bool]]:
    for w in places.tolist():
        yield w, w == places[-1]


def _judged(aim: Aim, pose: Array, at: Array, draws: Draws, is_end: bool) -> Misses:
    """Poses (M, 6) of the first M draws before base and unexplained errors, which move the tip about a pose at (6,)."""
    count = len(pose)
    off = aim.off_m(pose[:, :3] + draws.rigid(at[:3])[:count], is_end)
    if aim.direction is None or not is_end:
        return Misses(off, np.zeros(count))
    return Misses(off, aim.turned_rad(pose[:, 3:] + draws.turned(at[3:])[:count]))
