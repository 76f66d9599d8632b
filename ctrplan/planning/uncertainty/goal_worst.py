"""How far the tip may be displaced from a target, or its tangent turned from a direction, at worst, and by what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.uncertainty.contributors import FRICTION, REGISTRATION, SECOND_ORDER, shares
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.tip_slopes import TipSlopes, friction_states, poses_at
from ctrplan.uncertain.worst_case import BaseBall, Farthest, OffsetBox, farthest

POSITION, TANGENT = slice(0, 3), slice(3, 6)  # of a pose


@dataclass(frozen=True)
class WorstCase:
    """The largest distance of a vector from the one asked for; shares of its causes add up to it."""

    size: float  # m, or the chord of an angle on the unit sphere
    given: Mapping[str, float]
    saved: Mapping[str, float]  # by how much it shrinks where a cause is known exactly
    friction_state: tuple[float, ...]
    beyond_first_order: float  # by how much the solved worst case differs from the linear one; in `size`


@dataclass(frozen=True, eq=False)
class TipVector:
    """Position [m] or tangent of the tip at one configuration in S friction states, and what it shall be."""

    parameters: UncertainParameters
    theta: Array  # (1, n) commanded
    l: Array  # (1, n)  # noqa: E741 (as in the equations)
    slopes: TipSlopes  # (1, S)
    part: slice  # POSITION or TANGENT
    target: Array  # (3,)
    base: BaseBall

    @property
    def at(self) -> Array:
        """(S, 3)."""
        return self.slopes.pose[0, :, self.part]

    @property
    def by(self) -> Array:
        """(S, 3, P)."""
        return self.slopes.pose_by[0, :, self.part]

    @cached_property
    def _farthest(self) -> Farthest:
        return self._displaced(OffsetBox.of(self.parameters), self.by, self.base)

    def worst(self, off: str, rest: Mapping[str, float]) -> WorstCase:
        """With what is added besides; `off` is what the distance without friction and errors is called."""
        found, at, box = self._farthest, self.at, OffsetBox.of(self.parameters)
        state = int(np.argmax(found.length_m))
        u, offset = found.direction[state], box.middle + box.axes @ found.signs[state]
        beyond = self._beyond(state, offset)
        given = shares(self.parameters, u, self.by[state], offset, self.base, at[state], 0.0)
        given[FRICTION] = given.get(FRICTION, 0.0) + float(u @ (at[state] - at[0]))
        given |= {off: float(u @ (at[0] - self.target)), SECOND_ORDER: beyond, **rest}
        phi = tuple(friction_states(self.parameters.robot)[state].tolist())
        kept = {name: share for name, share in given.items() if share or name == FRICTION}
        return WorstCase(float(found.length_m[state]) + beyond + sum(rest.values()), kept, self._saved(), phi, beyond)

    def _beyond(self, state: int, offset: Array) -> float:
        if not self.parameters.count:
            return 0.0
        solved = poses_at(self.parameters, offset, self.theta, self.l)[0, state, self.part]
        linear = self.at[state] + self.by[state] @ offset
        return float(np.nan_to_num(np.linalg.norm(solved - linear), nan=np.inf))

    def _saved(self) -> dict[str, float]:
        """By how much the worst case shrinks where the parameters of one title, or the base, are known exactly."""
        titles, whole = np.array(self.parameters.title), float(self._farthest.length_m.max())
        found = {}
        for title in dict.fromkeys(titles.tolist()):
            known = titles == title
            left = self._displaced(OffsetBox.of(self.parameters.measured(known)), self.by[:, :, ~known], self.base)
            found[title] = whole - float(left.length_m.max())
        if self.base != BaseBall():
            left = self._displaced(OffsetBox.of(self.parameters), self.by, BaseBall())
            found[REGISTRATION] = whole - float(left.length_m.max())
        return found

    def _displaced(self, box: OffsetBox, by: Array, base: BaseBall) -> Farthest:
        return farthest(self.at - self.target, box.displaced(by), base, self.at)
