"""All equilibria of a robot without clearance and friction at given collars, by the torus of its tips' angles.

At their ends tubes carry no torsion. Angles there, relative to the tube around, are all that an equilibrium depends on:
from them the torsion equations (Rucker et al. 2010, eq. (3) of Ha et al. 2019 without clearance) are integrated towards
the plate, and end at relative angles R of the collars. R maps the torus of n - 1 angles at the tips to that of the
collars, wraps it around once, and depends on the translations alone. Every solution of R = alpha + 2 pi k, k
whole turns, is an equilibrium at relative collar angles alpha.

R has degree one: signs of its determinant, summed over all equilibria, make 1. Where a sum is another, one was missed.
An equilibrium is stable where the determinant of the integrated derivatives keeps its sign from the tips to the collars
(no conjugate point). Where R's determinant is positive on the whole torus there is one equilibrium at any rotation.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.mechanics.core_arrays import joint_row
from ctrplan.mechanics.tube import Loads

if TYPE_CHECKING:
    from ctrplan.mechanics.tube import Tube


class Tubes(Protocol):
    """What equilibria are enumerated of: a robot's tubes, the loads on them, and its file."""

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """Outermost first."""
        ...

    @property
    def loads(self) -> Loads:
        """Force, moment and weight."""
        ...

    @property
    def path(self) -> str | None:
        """For messages."""
        ...


STEP_M = 4e-3  # of the integration from the tips, of fourth order: angles are within 1e-6 rad of shorter ones
GRID = {1: 12, 2: 12, 3: 6, 4: 6}  # angles along each pair: none of 120 random configurations had one between them
NEAR_CELLS, DENSER = 1.5, 4  # of the grid, within which the first step has to lead; else so many times as dense
SAME_RAD = 1e-4  # between angles of one equilibrium
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

    @property
    def is_complete(self) -> bool:
        """Whether the signs add up."""
        return self.degree == 1

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Those in which the robot can stay."""
        return tuple(equilibrium for equilibrium in self.each if equilibrium.is_stable)

    def others(self, tip_m: Array) -> list[tuple[float, Equilibrium]]:
        """Stable ones beside the one whose tip is nearest to a tip (3,), and how far [m] from it theirs are."""
        apart = sorted(
            ((float(np.linalg.norm(shape.tip_m - tip_m)), shape) for shape in self.stable), key=lambda pair: pair[0]
        )
        return [(distance, shape) for distance, shape in apart[1:] if distance > apart[0][0] + SAME_SHAPE_M]

    def headline(self) -> str:
        """How many, as it shows itself."""
        missed = "" if self.is_complete else ", and some were missed"
        return f"{len(self.stable)} stable and {len(self.each) - len(self.stable)} unstable equilibria{missed}"


def equilibria(robot: Tubes, theta_b: ArrayLike, l_b: ArrayLike) -> Equilibria:
    """Every equilibrium without clearance and friction at collars (n,) [rad], (n,) [m], stable or not.

    Raises InputError for robots whose tubes carry loads, are oval or soften, and for more than five tubes.
    """
    theta, l = joint_row(theta_b, len(robot.tubes)), joint_row(l_b, len(robot.tubes))  # noqa: E741 (as in the equations)
    _refuse(robot)
    each, degree = Torus(robot.tubes, l).roots(np.diff(theta), float(theta[0]))
    return Equilibria(tuple(sorted(each, key=lambda equilibrium: equilibrium.energy_J)), degree)


def other_shapes(robot: Tubes, theta_b: ArrayLike, l_b: ArrayLike, tip_m: Array) -> list[tuple[float, Equilibrium]]:
    """Other stable equilibria than the one with a tip (3,), and how far [m] from it; none where they are refused."""
    try:
        return equilibria(robot, theta_b, l_b).others(tip_m)
    except InputError:
        return []


def is_unique(robot: Tubes, l_b: ArrayLike) -> bool:
    """Whether there is one equilibrium at every rotation of the collars, at translations (n,) [m].

    False where robots are of a kind that `equilibria` refuses.
    """
    try:
        _refuse(robot)
    except InputError:
        return False
    return bool(np.all(Torus(robot.tubes, joint_row(l_b, len(robot.tubes))).signs() > 0))


def _refuse(robot: Tubes) -> None:
    rule = ""
    if robot.loads != Loads():
        rule = "has loads, with which equilibria without clearance are not enumerated"
    elif any(tube.ovality or np.isfinite(tube.softening_strain) for tube in robot.tubes):
        rule = "has oval tubes or such that soften, of which equilibria are not enumerated"
    elif len(robot.tubes) - 1 > max(GRID):
        rule = f"has {len(robot.tubes)} tubes: equilibria are enumerated of at most {max(GRID) + 1}"
    if rule:
        raise InputError(rule, file=robot.path, key="tube")


@dataclass(frozen=True)
class _Stretch:
    """A stretch along which the same tubes, the inner ones from `first` on, have smooth precurvature."""

    begin: float
    end: float
    first: int
    u: Array  # (n, 2) precurvature at its begin [1/m]
    slope: Array  # (n, 2) per m


class Torus:
    """Angles at the tips of a robot with collars at translations (n,) [m], and where they lead to."""

    def __init__(self, tubes: tuple[Tube, ...], l_b: Array) -> None:
        """Cuts the tubes in front of the plate into stretches."""
        self.pairs = len(tubes) - 1
        EI = np.array([tube.bending_stiffness_Nm2 for tube in tubes])
        GJ = EI / (1 + np.array([tube.poisson_ratio for tube in tubes]))
        stretches = _stretches(tubes, l_b)
        self._core = _model.TorusTubes(
            EI=EI.tolist(),
            GJ=GJ.tolist(),
            behind=(l_b - GJ * [tube.shaft_compliance_rad_per_Nm for tube in tubes]).tolist(),
            begin=[part.begin for part in stretches],
            end=[part.end for part in stretches],
            first=[part.first for part in stretches],
            u=np.array([part.u for part in stretches]).reshape(-1, len(tubes), 2),
            slope=np.array([part.slope for part in stretches]).reshape(-1, len(tubes), 2),
        )

    def grid(self, times: int = 1) -> Array:
        """(Q, n - 1) angles at the tips, evenly over the torus, so many times as dense as GRID along each."""
        if not self.pairs:
            return np.zeros((1, 0))
        count = times * GRID[self.pairs]
        steps = np.arange(count) * 2 * np.pi / count
        return np.stack(np.meshgrid(*[steps] * self.pairs, indexing="ij"), axis=-1).reshape(-1, self.pairs)

    def signs(self) -> NDArray[np.int64]:
        """(Q,) signs of the determinant of R's derivatives on the grid."""
        return np.asarray(self._core.signs(self.grid(), STEP_M))

    def roots(self, alpha: Array, outermost_rad: float) -> tuple[list[Equilibrium], int]:
        """Equilibria at relative collar angles (n - 1,), the outermost collar at an angle, and the sum of their signs.

        Newton's method begins where the grid's derivatives lead into the cell around; from everywhere on a denser grid
        if the signs of what that finds do not add up.
        """
        rows: list[Any] = []
        for times, cells in ((1, NEAR_CELLS), (DENSER, np.inf)):
            reach_rad = cells * 2 * np.pi / GRID[max(self.pairs, 1)]
            rows = self._core.roots(self.grid(times), alpha.tolist(), outermost_rad, reach_rad, SAME_RAD, STEP_M)
            if sum(row[2] for row in rows) == 1:
                break
        each = [
            Equilibrium(tip_m, np.remainder(psi, 2 * np.pi), twist, energy_J, is_stable)
            for psi, twist, _, is_stable, energy_J, tip_m in rows
        ]
        return each, sum(row[2] for row in rows)


def _stretches(tubes: tuple[Tube, ...], l_b: Array) -> list[_Stretch]:
    """From the plate to the tip; where tubes end in order, the inner ones farther out."""
    breaks, ends = {0.0}, [float(l + tube.length_m) for l, tube in zip(l_b, tubes, strict=True)]  # noqa: E741
    for tube, begin in zip(tubes, l_b.tolist(), strict=True):
        at = begin
        for section in tube.sections:
            at += section.length_m
            breaks.add(max(at, 0.0))
    results, points = list[_Stretch](), sorted(breaks)
    for a, b in itertools.pairwise(points):
        if b - a < 1e-9:
            continue
        middle = (a + b) / 2
        first = next(i for i in range(len(tubes)) if max(ends[i:]) > middle and ends[i] > middle)
        pieces = [_precurvature(tube, middle - begin, a - begin) for tube, begin in zip(tubes, l_b, strict=True)]
        u, slope = (np.array(part) for part in zip(*pieces, strict=True))
        results.append(_Stretch(a, b, first, u, slope))
    return results


def _precurvature(tube: Tube, inside: float, at: float) -> tuple[list[float], list[float]]:
    """Precurvature (2,) [1/m] at `at`, and its slope, of the section that `inside` lies in; lengths from the base."""
    begin = 0.0
    for section in tube.sections:
        if begin < inside < begin + section.length_m:
            mean = np.array([section.curvature_x_per_m, section.curvature_y_per_m])
            slope = 2 * section.gradient / section.length_m
            return (mean * (1 - section.gradient + slope * (at - begin))).tolist(), (mean * slope).tolist()
        begin += section.length_m
    return [0.0, 0.0], [0.0, 0.0]
