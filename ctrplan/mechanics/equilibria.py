"""All equilibria of a robot at given collars, by the torus of its tips' angles without clearance and friction.

At their ends tubes carry no torsion. Angles there, relative to the tube around, are all that an equilibrium depends on:
from them the torsion equations (Rucker et al. 2010, eq. (3) of Ha et al. 2019 without clearance) are integrated towards
the plate, and end at relative angles R of the collars. R maps the torus of n - 1 angles at the tips to that of the
collars, wraps it around once, and depends on the translations alone. Every solution of R = alpha + 2 pi k, k
whole turns, is an equilibrium at relative collar angles alpha.

R has degree one: signs of its determinant, summed over all equilibria, make 1. Where a sum is another, one was missed.
An equilibrium is stable where the determinant of the integrated derivatives keeps its sign from the tips to the collars
(no conjugate point). Where R's determinant is positive on the whole torus there is one equilibrium at any rotation.

Clearance and friction remove some and add others. The robot with them is solved from the shapes without: what converges
to a stable shape is a branch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.mechanics.core_arrays import joint_row
from ctrplan.mechanics.friction import corner_signs
from ctrplan.mechanics.guide import Led, led_back
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import Loads, stretches

if TYPE_CHECKING:
    from ctrplan.mechanics.core import Mechanics
    from ctrplan.mechanics.friction import Branched
    from ctrplan.mechanics.shapes import Accuracy
    from ctrplan.mechanics.tube import Tube


class Tubes(Protocol):
    """What equilibria are enumerated of: a robot's tubes, the loads on them, and its file."""

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """Outermost first."""

    @property
    def loads(self) -> Loads:
        """Force, moment and weight."""

    @property
    def path(self) -> str | None:
        """For messages."""

    @property
    def mechanics(self) -> Mechanics:
        """What solves with clearance and friction."""


STEP_M = 4e-3  # of the integration from the tips, of fourth order: angles are within 1e-6 rad of shorter ones
GRID = {1: 12, 2: 12, 3: 6, 4: 6}  # angles along each pair: none of 120 random configurations had one between them
NEAR_CELLS, DENSER = 1.5, 4  # of the grid, within which the first step has to lead; else so many times as dense
SAME_RAD = 1e-4  # between angles of one equilibrium
BEYOND = (4.0, 2.0, 1.0)  # times as far as friction turns the tips: it may hold more on a branch that is not known yet
NEAR_RAD = 0.2  # of angles at the tips, within which a root without clearance leads to a solution that is known
SAME_SHAPE_M = 0.5e-3  # between solutions of one shape: walked to or found afresh, with clearance or without


@shown
@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One of the shapes that a robot without clearance and friction can have."""

    tip_m: Array  # (3,) robot frame
    tip_angles_rad: Array  # (n - 1,) of each tube's end against the end of the tube around it
    twist_rad: Array  # (n - 1,) of each pair from tip to collar: half a turn and more where it is wound up
    energy_J: float  # of bending and torsion
    is_stable: bool

    def headline(self) -> str:
        """What it is, as it shows itself."""
        at = ", ".join(f"{x * 1e3:.2f}" for x in self.tip_m)
        wound = ", ".join(f"{np.degrees(x):+.0f}" for x in self.twist_rad)
        kind = "stable" if self.is_stable else "unstable"
        return f"{kind} equilibrium, tip at ({at}) mm, pairs twisted by ({wound}) deg, {self.energy_J * 1e3:.2f} mJ"


@shown
@dataclass(frozen=True, eq=False)
class Equilibria:
    """All of them at one configuration, the least energy first."""

    each: tuple[Equilibrium, ...]
    degree: int  # sum of signs, 1 unless some were missed
    look: Callable[[], tuple[Branch, ...]] = field(repr=False)

    @cached_property
    def branches(self) -> tuple[Branch, ...]:
        """The stable shapes with clearance and friction that these lead to, solved when somebody asks."""
        return self.look()

    @property
    def is_complete(self) -> bool:
        """Whether the signs add up."""
        return self.degree == 1

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Stable equilibria, in which the robot can stay."""
        return tuple(equilibrium for equilibrium in self.each if equilibrium.is_stable)

    def headline(self) -> str:
        """How many, as it shows itself."""
        missed = "" if self.is_complete else ", and some were missed"
        return f"{len(self.stable)} stable and {len(self.each) - len(self.stable)} unstable equilibria{missed}"


def equilibria(robot: Tubes, theta_b: ArrayLike, l_b: ArrayLike) -> Equilibria:
    """Every equilibrium without clearance and friction at collars (n,) [rad], (n,) [m], stable or not.

    Raises InputError for robots whose tubes carry loads, are oval or soften, and for more than five tubes.
    """
    theta, l = joint_row(theta_b, len(robot.tubes)), joint_row(l_b, len(robot.tubes))  # noqa: E741 (as in the equations)
    refuse_other_kinds(robot)
    each, degree = Torus(robot.tubes, l).roots(np.diff(theta), float(theta[0]))
    in_order = tuple(sorted(each, key=lambda equilibrium: equilibrium.energy_J))
    return Equilibria(in_order, degree, partial(branches, robot, theta, l))


@shown
@dataclass(frozen=True, eq=False)
class Branch:
    """A stable shape with clearance, without friction and in the C sign corners of friction: states where it exists.

    It counts as soon as one of its states is solved.
    """

    tip_m: Array  # (1 + C, 3) robot frame; NaN where it has no equilibrium
    twist_rad: Array  # (1 + C, n - 1) of each pair from tip to collar
    angles_rad: Array  # (1 + C, n, K) of every tube along the robot
    energy_J: float  # of the equilibrium without clearance that it was begun from

    @property
    def solved(self) -> NDArray[np.bool_]:
        """(1 + C,) where it has an equilibrium."""
        return np.isfinite(self.tip_m[:, 0])

    @property
    def first(self) -> int:
        """The state that stands for it: the frictionless one where there is one."""
        return int(np.argmax(self.solved))

    def headline(self) -> str:
        """What it is, as it shows itself."""
        at = ", ".join(f"{x * 1e3:.2f}" for x in self.tip_m[self.first])
        wound = ", ".join(f"{np.degrees(x):+.0f}" for x in self.twist_rad[self.first])
        kind = "stable shape" if self.solved[0] else "shape that friction holds"
        return f"{kind}, tip at ({at}) mm, pairs twisted by ({wound}) deg, {self.energy_J * 1e3:.2f} mJ"


def branches(robot: Tubes, theta_b: ArrayLike, l_b: ArrayLike, *, accuracy: Accuracy = "search") -> tuple[Branch, ...]:
    """Stable shapes with clearance and friction at collars (n,) [rad], (n,) [m], those without clearance first.

    The frictionless robot and each sign corner of friction are solved from every stable equilibrium without clearance.
    Friction turns the tips as if the collars stood elsewhere: the equilibria there are begun from as well. Raises
    InputError as `equilibria` does.
    """
    refuse_other_kinds(robot)
    looked = _Looked(robot, joint_row(theta_b, len(robot.tubes)), joint_row(l_b, len(robot.tubes)), accuracy)
    looked.begin()
    looked.begin_pointwise()
    looked.begin_beside()
    return tuple(looked.branches())


def other_shapes(robot: Tubes, theta_b: ArrayLike, l_b: ArrayLike, tip_m: Array) -> list[tuple[float, Branch]]:
    """Other branches than the one with a frictionless tip (3,), and how far [m] from it they are, the nearest first.

    None where robots are of a kind that `equilibria` refuses.
    """
    if is_unique(robot, l_b):
        return []
    try:
        each = branches(robot, theta_b, l_b)
    except InputError:
        return []
    away = [(float(np.linalg.norm(equilibrium.tip_m[equilibrium.first] - tip_m)), equilibrium) for equilibrium in each]
    return sorted((pair for pair in away if pair[0] > SAME_SHAPE_M), key=lambda pair: pair[0])


@dataclass(frozen=True, eq=False)
class OtherBranch:
    """A branch that is not the one that was walked to."""

    branch: Branch
    turns: NDArray[np.int_]  # (P,) whole turns of the pairs' collars that lead to it
    apart_m: Array  # (1 + C,) of its tip from that of the same friction state; NaN where it has no equilibrium


def other_branches(each: Sequence[Branch], tip_m: Array) -> list[OtherBranch]:
    """Those of `each` that lie apart from the tips (1 + C, 3) of what was walked to, and in which friction states.

    Where what was walked to is not among them, nothing is known of turns: the branch nearest to it takes its place. No
    turns are needed to one that friction alone leads to.
    """
    apart = [np.linalg.norm(branch.tip_m - tip_m, axis=1) for branch in each]
    own = min(zip(apart, each, strict=True), key=lambda pair: np.nanmin(pair[0], initial=np.inf), default=(0, None))[1]
    results = list[OtherBranch]()
    for branch, away in zip(each, apart, strict=True):
        if own is None or branch is own:
            continue
        both = np.flatnonzero(branch.solved & own.solved)
        a, b = (both[0], both[0]) if len(both) else (branch.first, own.first)
        turns = np.round((branch.twist_rad[a] - own.twist_rad[b]) / (2 * np.pi)).astype(int)
        led = ~own.solved & (away <= SAME_SHAPE_M)  # from the own one, which ends before friction is there
        if led.any():
            turns, away = np.zeros_like(turns), np.linalg.norm(branch.tip_m - own.tip_m[own.first], axis=1)
        away = np.where(away > SAME_SHAPE_M, away, np.nan)
        if np.isfinite(away).any():
            results.append(OtherBranch(branch, turns, away))
    return results


def is_unique(robot: Tubes, l_b: ArrayLike) -> bool:
    """Whether there is one equilibrium at every rotation of the collars, at translations (n,) [m].

    False where robots are of a kind that `equilibria` refuses.
    """
    try:
        refuse_other_kinds(robot)
    except InputError:
        return False
    return bool(np.all(Torus(robot.tubes, joint_row(l_b, len(robot.tubes))).map()[1] > 0))


def refuse_other_kinds(robot: Tubes) -> None:
    """Raises InputError for robots of which equilibria are not enumerated."""
    rule = ""
    if robot.loads != Loads():
        rule = "has loads, with which equilibria without clearance are not enumerated"
    elif any(tube.ovality or np.isfinite(tube.softening_strain) for tube in robot.tubes):
        rule = "has oval tubes or such that soften, of which equilibria are not enumerated"
    elif len(robot.tubes) - 1 > max(GRID):
        rule = f"has {len(robot.tubes)} tubes: equilibria are enumerated of at most {max(GRID) + 1}"
    if rule:
        raise InputError(rule, file=robot.path, key="tube")


class Torus:
    """Angles at the tips of a robot with collars at translations (n,) [m], and where they lead to."""

    def __init__(self, tubes: tuple[Tube, ...], l_b: Array) -> None:
        """Cuts the tubes in front of the plate into stretches."""
        self.pairs = len(tubes) - 1
        EI = np.array([tube.bending_stiffness_Nm2 for tube in tubes])
        GJ = EI / (1 + np.array([tube.poisson_ratio for tube in tubes]))
        parts = stretches(tubes, l_b)
        self._core = _model.TipTorus(
            EI=EI.tolist(),
            GJ=GJ.tolist(),
            behind=(l_b - GJ * [tube.shaft_compliance_rad_per_Nm for tube in tubes]).tolist(),
            begin=[part.begin for part in parts],
            end=[part.end for part in parts],
            first=[part.first for part in parts],
            u=np.array([part.u for part in parts]).reshape(-1, len(tubes), 2),
            slope=np.array([part.slope for part in parts]).reshape(-1, len(tubes), 2),
            step=STEP_M,
        )

    def map(self) -> tuple[Array, Array]:
        """R (Q, n - 1) [rad] on the grid, and the determinant of its derivatives (Q,)."""
        R, determinant = self._core.map(self._count())
        return np.asarray(R), np.asarray(determinant)

    def roots(self, alpha: Array, outermost_rad: float) -> tuple[list[Equilibrium], int]:
        """Equilibria at relative collar angles (n - 1,), the outermost collar at an angle, and their signs' sum."""
        return self.all_roots(alpha[None], [outermost_rad])[0]

    def all_roots(self, alpha: Array, outermost_rad: Sequence[float]) -> list[tuple[list[Equilibrium], int]]:
        """Equilibria and the sum of their signs at relative collar angles (A, n - 1) [rad], outermost ones (A,).

        Newton's method begins where the grid's derivatives lead into the cell around; on a denser grid, near there and
        then from everywhere, if the signs of what that finds do not add up.
        """
        results: list[Any] = [None] * len(alpha)
        left = list(range(len(alpha)))
        for times, cells in ((1, NEAR_CELLS), (DENSER, NEAR_CELLS), (DENSER, np.inf)):
            reach_rad = cells * 2 * np.pi / GRID[max(self.pairs, 1)]
            turned = np.ascontiguousarray(alpha[left]), [float(outermost_rad[k]) for k in left]
            every = self._core.roots(self._count(times), *turned, reach_rad, SAME_RAD)
            for k, rows in zip(left, every, strict=True):
                results[k] = rows
            left = [k for k in left if sum(row[2] for row in results[k]) != 1]
            if not left:
                break
        return [
            (
                [
                    Equilibrium(tip_m, np.remainder(psi, 2 * np.pi), twist, energy_J, is_stable)
                    for psi, twist, _, is_stable, energy_J, tip_m in rows
                ],
                sum(row[2] for row in rows),
            )
            for rows in results
        ]

    def shapes(self, tip_angles_rad: Array, outermost_rad: Sequence[float]) -> tuple[Array, Array]:
        """Arc lengths (K,) [m], and angles (G, n, K) of every tube there where the tips stand at (G, n - 1)."""
        s_m, theta = self._core.shapes(np.ascontiguousarray(tip_angles_rad), list(outermost_rad))
        return np.asarray(s_m), np.asarray(theta)

    def _count(self, times: int = 1) -> int:
        """Angles along each pair, so many times GRID."""
        return times * GRID[max(self.pairs, 1)]


class _Looked:
    """What was solved at one configuration, branch by branch."""

    def __init__(self, robot: Tubes, theta: Array, l: Array, accuracy: Accuracy) -> None:  # noqa: E741
        """Nothing yet, at collars (n,) [rad], (n,) [m]."""
        self.mechanics, self.theta, self.l, self.accuracy = robot.mechanics, theta, l, accuracy
        self.torus = Torus(robot.tubes, l)
        self.phi = np.vstack([np.zeros(len(theta) - 1), corner_signs(len(theta) - 1)])
        self.tips, self.angles, self.energy = list[Array](), list[Array](), list[float]()
        self.s_m, self.stable = np.zeros(0), list[Equilibrium]()

    def begin(self) -> None:
        """Every state from every stable equilibrium without clearance."""
        roots, _ = self.torus.roots(np.diff(self.theta), float(self.theta[0]))
        self.stable = [root for root in roots if root.is_stable]
        states = range(len(self.phi))
        for root in self.stable:
            shape = self._shape(root, np.zeros(len(self.theta) - 1))
            self._add(states, self._solve(np.array(states), np.repeat(shape[None], len(states), axis=0)), root.energy_J)

    def _extend(self, tips: Array, angles: Array) -> None:
        """States that a branch lacks, from those that it has."""
        while len(missing := np.flatnonzero(np.isnan(tips[:, 0]))):
            there = np.flatnonzero(np.isfinite(tips[:, 0]))
            apart = np.abs(self.phi[missing, None] - self.phi[there]).sum(axis=2)
            rows = self._solve(missing, angles[there[apart.argmin(axis=1)]])
            new = [k for k, state in enumerate(missing.tolist()) if self._is_new(state, rows, k)]
            if not new:
                break
            tips[missing[new]], angles[missing[new]] = rows.tip_m[new], rows.angles_rad[new]

    def begin_pointwise(self) -> None:
        """States as they are solved by themselves, which a fold may part from every shape without friction."""
        collars = np.tile(self.theta, (len(self.phi), 1)), np.tile(self.l, (len(self.phi), 1))
        tips = self.mechanics.tips_with_friction(*collars, self.phi, accuracy=self.accuracy)
        for state in np.flatnonzero(tips.status == Status.CONVERGED).tolist() if self.stable else ():
            if not self._is_known(state, tips.position_m[state]):
                shape = self.mechanics.solve(self.theta, self.l, self.phi[state], accuracy=self.accuracy)
                angles = np.array([np.interp(self.s_m, tube.s_m, tube.theta_rad) for tube in shape.tubes])
                near = min(self.stable, key=lambda root: _apart(root.tip_angles_rad, np.diff(angles[:, -1])))
                self._add([state], self._solve(np.array([state]), angles[None]), near.energy_J)

    def begin_beside(self) -> None:
        """States from equilibria without clearance at collars that would turn the tips BEYOND times as far as friction
        does. Friction the other way turns them back, where no more is known of a state.
        """
        if not (known := self._known_tips()):
            return
        turned = self.torus.shapes(np.array([psi for _, psi in known]), [0.0] * len(known))[1][:, :, 0]
        alpha, has = np.diff(self.theta), {state for state, _ in known}
        off = list(zip([state for state, _ in known], _principal(np.diff(turned, axis=1) - alpha), strict=True))
        off += [(len(self.phi) - state, -by) for state, by in off if state and len(self.phi) - state not in has]
        for factor in BEYOND:
            self._begin_beside([(state, factor * by) for state, by in off])

    def _begin_beside(self, beside: list[tuple[int, Array]]) -> None:
        """States from equilibria at collars beside (n - 1,), but for angles at the tips that lead to known ones."""
        known, alpha = self._known_tips(), np.diff(self.theta) + np.array([by for _, by in beside])
        every = self.torus.all_roots(alpha, [float(self.theta[0])] * len(beside))
        guesses = [
            (state, root, by)
            for (state, by), (roots, _) in zip(beside, every, strict=True)
            for root in (roots if len(roots) > 1 else ())
            if root.is_stable
            and min((_apart(psi, root.tip_angles_rad) for k, psi in known if k == state), default=np.inf) > NEAR_RAD
        ]
        led = [Led(k, state, self._shape(root, by)) for k, (state, root, by) in enumerate(guesses)]
        off = np.array([np.append(0.0, np.cumsum(by)) for *_, by in guesses])

        def solve(each: list[Led], left: list[float]) -> Branched:
            states, shapes = np.array([way.state for way in each]), np.array([way.angles for way in each])
            share = np.array(left)[:, None]
            return self._solve(states, shapes, share * off[[way.guess for way in each]], share)

        for way, rows, row in led_back(led, len(self.phi), solve):
            self._add([way.state], rows, guesses[way.guess][1].energy_J, row)

    def _known_tips(self) -> list[tuple[int, Array]]:
        """States with angles at the tips (n - 1,) [rad] that were solved."""
        tips = [(state, np.diff(angles[state, :, -1])) for angles in self.angles for state in range(len(self.phi))]
        return [(state, psi) for state, psi in tips if np.isfinite(psi[0])]

    def branches(self) -> Iterator[Branch]:
        """All of them."""
        for tips, angles, energy_J in zip(self.tips, self.angles, self.energy, strict=True):
            twist = np.diff(angles[:, :, 0] - angles[:, :, -1], axis=1)
            yield Branch(tips, twist, angles, energy_J)

    def _shape(self, root: Equilibrium, beside: Array) -> Array:
        """(n, K) angles of a root for collars that stand `beside` (n - 1,), with the whole turns of the collars."""
        self.s_m, angles = self.torus.shapes(root.tip_angles_rad[None], [float(self.theta[0])])
        collar = self.theta + np.append(0.0, np.cumsum(beside))
        whole = np.round((collar - angles[0, :, 0]) / (2 * np.pi))
        return np.asarray(angles[0] + 2 * np.pi * whole[:, None])

    def _solve(self, states: NDArray[np.intp], angles: Array, on: Any = 0.0, left: Any = 0.0) -> Branched:
        """States from angles; collars stand (S, n) farther on, and shares `left` (S, 1) of friction are missing."""
        theta = np.tile(self.theta, (len(states), 1)) + on
        phi = (1 - left) * self.phi[states]
        return self.mechanics.core_solve_from(theta, self.l, phi, self.s_m, angles, self.accuracy)

    def _is_new(self, state: int, rows: Branched, row: int) -> bool:
        return rows.status[row] == Status.CONVERGED and not self._is_known(state, rows.tip_m[row])

    def _is_known(self, state: int, tip_m: Array) -> bool:
        """Whether a branch that was solved has a tip (3,) in a friction state."""
        return any(np.linalg.norm(tips[state] - tip_m) < SAME_SHAPE_M for tips in self.tips)

    def _add(self, states: Iterable[int], rows: Branched, energy_J: float, first: int = 0) -> None:
        """A branch of states that are new, solved in rows from a first one on, and of what is reached from there."""
        tips = np.full((len(self.phi), 3), np.nan)
        angles = np.full((len(self.phi), len(self.theta), len(self.s_m)), np.nan)
        for k, state in enumerate(states, start=first):
            if self._is_new(state, rows, k):
                tips[state], angles[state] = rows.tip_m[k], rows.angles_rad[k]
        if np.isfinite(tips).any():
            self._extend(tips, angles)
            self.tips.append(tips)
            self.angles.append(angles)
            self.energy.append(energy_J)


def _apart(tips_rad: Array, other_rad: Array) -> float:
    """[rad] the largest difference of angles at the tips (n - 1,), without whole turns."""
    return float(np.abs(_principal(tips_rad - other_rad)).max())


def _principal(angle: Array) -> Array:
    """Angles [rad] less whole turns, from -pi to pi."""
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))
