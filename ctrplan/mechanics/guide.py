"""The branch of equilibria that a robot stands on, along a way of its collars: shapes that solves begin from.

A robot may have several stable shapes at the same collars. By itself the core solves the one that a robot without
precurvature leads to. A robot that stands on another branch is followed: each shape is solved from that before it, in
steps so short that no other is reached, by the rule that the core has too (`Guide` in `model/`). Whatever is solved
beside the way begins from the nearest one.
Branches end at folds, and so do guides.

States of friction are led in the same way from shapes without it, at collars that stand beside, while it grows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ctrplan import _model
from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import Status

if TYPE_CHECKING:
    from ctrplan.mechanics.friction import Branched
    from ctrplan.mechanics.shapes import Accuracy, Shape

STEP_RAD, STEP_M, CORRECTION_RAD, SHORTEST = _model.GUIDE_STEPS
PLACES = 200  # along the robot at which angles are kept, straight in between: a shape to begin from, no solution
LEAST = 1 / 16  # of the way from collars beside, the shortest step while friction grows


class ShapeSolver(Protocol):
    """What a shape is led on by: the robot's own mechanics."""

    def core_solve_from(
        self, theta_b: Array, l_b: Array, phi: Array, s_m: Array, angles: Array, accuracy: Accuracy
    ) -> Branched:
        """Solved from given shapes, as `ctrplan.mechanics.core.Mechanics`."""
        ...


@dataclass(frozen=True, eq=False)
class Guide:
    """Shapes at R places of a way, angles of every tube at K arc lengths; without friction, unless a state is given."""

    theta_b: Array  # (R, n) rad
    l_b: Array  # (R, n) m
    s_m: Array  # (K,) from the plate
    angles_rad: Array  # (R, n, K)
    tip_m: Array  # (R, 3) robot frame
    phi: Array | None = None  # (n - 1,) friction state that all are solved in

    @classmethod
    def of(cls, mechanics: ShapeSolver, theta_b: Array, l_b: Array, shape: Shape) -> Guide | None:
        """The frictionless shape next to another one at collars (n,) [rad], (n,) [m]; None where there is none."""
        ends = [tube.s_m[[0, -1]] for tube in shape.tubes]
        s_m = np.linspace(min(first for first, _ in ends), max(last for _, last in ends), PLACES)
        angles = np.array([np.interp(s_m, tube.s_m, tube.theta_rad) for tube in shape.tubes])
        given = cls(theta_b[None], l_b[None], s_m, angles[None], np.full((1, 3), np.nan))
        return given._solved(mechanics, theta_b, l_b, np.inf)  # the other one may bear friction

    def at(self, row: int) -> Guide:
        """One of the shapes alone."""
        rows = slice(row, row + 1 or None)
        return replace(
            self,
            theta_b=self.theta_b[rows],
            l_b=self.l_b[rows],
            angles_rad=self.angles_rad[rows],
            tip_m=self.tip_m[rows],
        )

    def near(self, theta_b: Array, l_b: Array) -> Guide:
        """The shape at the place nearest to collars (n,) [rad], (n,) [m]; of several there the first one of the way."""
        apart = np.abs(self.theta_b - theta_b).max(axis=1) / STEP_RAD + np.abs(self.l_b - l_b).max(axis=1) / STEP_M
        return self.at(int(np.argmin(apart)))

    def along(self, mechanics: ShapeSolver, theta_b: Array, l_b: Array) -> Guide:
        """Followed from the last shape along waypoints (K, n) [rad], (K, n) [m], straight in between, to where the
        branch ends.
        """
        here, parts = self.at(-1), [self]
        for theta, l in zip(theta_b, l_b, strict=True):  # noqa: E741 (as in the equations)
            begin, share, step = here, 0.0, 1.0
            most = max(np.abs(theta - begin.theta_b[0]).max() / STEP_RAD, np.abs(l - begin.l_b[0]).max() / STEP_M)
            if most == 0:
                continue
            most = max(most, 1.0)
            while share < 1:
                longer = min(step, 1 / most, 1 - share)
                now = share + longer if share + longer < 1 - 1e-9 else 1.0
                way = (a + now * (b - a) for a, b in ((begin.theta_b[0], theta), (begin.l_b[0], l)))
                ahead = here._solved(mechanics, *way)
                if ahead is None:
                    step = longer / 2
                    if step * most < SHORTEST:
                        return _joined(parts)
                    continue
                here, share, step = ahead, now, 2 * longer
                parts.append(here)
        return _joined(parts)

    def _solved(
        self, mechanics: ShapeSolver, theta_b: Array, l_b: Array, most_rad: float = CORRECTION_RAD
    ) -> Guide | None:
        """The only shape led on to collars (n,), (n,) near by; None where that is not solved or leaps."""
        turned = self.angles_rad + (theta_b - self.theta_b)[..., None]
        phi = np.zeros(len(theta_b) - 1) if self.phi is None else self.phi
        try:
            rows = mechanics.core_solve_from(theta_b[None], l_b, phi[None], self.s_m, turned, "search")
        except InputError:  # collars that do not nest
            return None
        if rows.status[0] != Status.CONVERGED or np.abs(rows.angles_rad - turned).max() > most_rad:
            return None
        return replace(self, theta_b=theta_b[None], l_b=l_b[None], angles_rad=rows.angles_rad, tip_m=rows.tip_m)


@dataclass(frozen=True, eq=False)
class Led:
    """A friction state on its way to the collars from others, where it was solved without friction."""

    guess: int  # that it began from
    state: int
    angles: Array  # (n, K) where it was solved last, a guess at first
    left: float = 1.0  # of the way
    step: float = 1.0  # of it, halved where it fails


def led_back(
    led: list[Led], count: int, solve: Callable[[list[Led], list[float]], Branched]
) -> Iterator[tuple[Led, Branched, int]]:
    """Those of `led` that arrive at the collars, with rows that were solved there and which of them.

    At once, or while friction grows on the way. Where one of `count` states ends at a fold, all others are begun from
    its last shape: another may hold what it did not. `solve` takes what is led, and shares of the way that are left.
    """
    tried = {(each.guess, each.state) for each in led}
    while led:
        to = [max(each.left - each.step, 0.0) for each in led]
        rows, going, begun, ended = solve(led, to), list[Led](), list[Led](), dict[int, Led]()
        for row, (each, left) in enumerate(zip(led, to, strict=True)):
            if rows.status[row] == Status.CONVERGED and left == 0:
                yield each, rows, row
            elif rows.status[row] == Status.CONVERGED:
                going.append(replace(each, angles=rows.angles_rad[row], left=left, step=2 * each.step))
            elif each.left == 1 and each.step == 1:
                begun.append(replace(each, step=0.5))
            elif each.step > LEAST:
                going.append(replace(each, step=each.step / 2))
            elif each.left < 1:
                ended[each.guess] = each
        every = [replace(each, state=state, step=each.left) for each in ended.values() for state in range(count)]
        begun += [each for each in every if (each.guess, each.state) not in tried]
        tried |= {(each.guess, each.state) for each in begun}
        if begun:
            rows = solve(begun, [each.left for each in begun])
            solved = np.flatnonzero(rows.status == Status.CONVERGED)
            going += [replace(begun[row], angles=rows.angles_rad[row]) for row in solved]
        led = going


def _joined(parts: list[Guide]) -> Guide:
    names = ("theta_b", "l_b", "angles_rad", "tip_m")
    return replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
