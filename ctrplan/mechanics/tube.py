"""Precurved tubes, the contacts between neighbours, external loads, and the rule of nesting.

Tips of retractable tubes need not: such a tube may end inside the one around it. The planner keeps them in order all
the same, for its certificates are of tips in order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import Number, read_plain_fields, rows_of
from ctrplan.base.arrays import ORIGIN, ROUNDING_M, Array
from ctrplan.base.package import shown
from ctrplan.errors import InputError

SOFTEST_NM2, STIFFEST_NM2 = 1e-9, 1e6
CELL_M = 0.015  # m, the longest cell that is bent by itself; a tolerance: half of it off, 2 deg move a tip by 0.3 mm

# What the core is told of a tube; files have narrower ranges in their own units. Fits go beyond what files may say.
RANGES = {
    "outer_diameter_m": Number(0, 1, "m", above=True),
    "inner_diameter_m": Number(0, 1, "m"),
    "bending_stiffness_Nm2": Number(SOFTEST_NM2, STIFFEST_NM2, "N m^2"),
    "poisson_ratio": Number(-1, 99, above=True),
    "collar_length_m": Number(0, 5, "m"),
    "max_strain": Number(0, 1),
    "density_kg_m3": Number(0, 1e5, "kg/m^3"),
    "ovality": Number(-1, 1),
    "ovality_axis_rad": Number(-1e3, 1e3, "rad"),
    "softening_strain": Number(0, math.inf),
    "softening_fraction": Number(0, 1e3),
    "shaft_compliance_rad_per_Nm": Number(0, 1e6, "rad/(N m)"),
}
SECTION_RANGES = {
    "length_m": Number(0, 5, "m", above=True),
    "curvature_x_per_m": Number(-1e4, 1e4, "1/m"),
    "curvature_y_per_m": Number(-1e4, 1e4, "1/m"),
    "gradient": Number(-1e3, 1e3),
}


@shown
@dataclass(frozen=True)
class TubeSection:
    """A piece of constant or linearly varying precurvature, a rotation rate: y > 0 bends towards +x at theta = 0."""

    length_m: float
    curvature_x_per_m: float
    curvature_y_per_m: float
    gradient: float = 0.0  # precurvature at x from its base: (1 + gradient (2 x / length - 1)) times the mean
    bent: tuple[tuple[int, float, float], ...] = ()  # cells from 1, and by how much each is bent about x and y [rad]

    def __post_init__(self) -> None:
        """Raises InputError for what is no number."""
        read_plain_fields(self)

    @property
    def cells(self) -> int:
        """How many equal cells it has."""
        return max(1, math.ceil(self.length_m / CELL_M - 1e-9))

    @property
    def cuts(self) -> list[int]:
        """Where its pieces end, in cells from its base, 0 among them."""
        return sorted({0, self.cells, *(end for cell, _, _ in self.bent for end in (cell - 1, cell))})

    def factor(self, begin: int, end: int) -> float:
        """Its drawn precurvature in the middle of a piece between two cuts, over the mean."""
        return 1 + self.gradient * ((begin + end) / self.cells - 1)

    @property
    def pieces(self) -> tuple[TubeSection, ...]:
        """Itself, or what it is where cells are bent: pieces of their own precurvature."""
        if not self.bent:
            return (self,)
        bends, results = {cell: (x, y) for cell, x, y in self.bent}, list[TubeSection]()
        for begin, end in pairwise(self.cuts):
            length, factor = self.length_m * (end - begin) / self.cells, self.factor(begin, end)
            x, y = bends.get(end, (0.0, 0.0)) if end - begin == 1 else (0.0, 0.0)
            rates = factor * self.curvature_x_per_m + x / length, factor * self.curvature_y_per_m + y / length
            share = (end - begin) / self.cells
            results.append(TubeSection(length, *rates, self.gradient * share / factor if factor else 0.0))
        return tuple(results)

    @property
    def curvature_per_m(self) -> float:
        """Magnitude [1/m] of the precurvature."""
        return math.hypot(self.curvature_x_per_m, self.curvature_y_per_m)


@shown
@dataclass(frozen=True)
class Tube:
    """One tube, its sections from base to tip; torsional stiffness is bending_stiffness_Nm2 / (1 + poisson_ratio)."""

    outer_diameter_m: float
    inner_diameter_m: float  # 0: a wire
    bending_stiffness_Nm2: float
    poisson_ratio: float  # EI / GJ - 1, which may be that of no material where both were fitted
    sections: tuple[TubeSection, ...]
    collar_length_m: float = 0.0  # least distance of this tube's base behind the base of the tube around it
    max_strain: float = 0.08
    density_kg_m3: float = 0.0
    ovality: float = 0.0  # EI (1 + ovality) for bending along one axis, EI (1 - ovality) across
    ovality_axis_rad: float = 0.0  # of that axis in the tube
    softening_strain: float = math.inf  # of r_out |u - u_hat|, where the bending stiffness drops (NiTi)
    softening_fraction: float = 1.0  # tangent stiffness beyond it over EI
    shaft_compliance_rad_per_Nm: float = 0.0  # torsion between actuator and collar
    retractable: bool = False  # whether its tip may be drawn back behind that of the tube around it

    def __post_init__(self) -> None:
        """Takes any sequence of sections. Raises InputError for what is none."""
        read_plain_fields(self)
        object.__setattr__(self, "sections", rows_of("sections", self.sections, TubeSection))

    @property
    def pieces(self) -> tuple[TubeSection, ...]:
        """Its sections, cut where cells are bent."""
        return tuple(piece for section in self.sections for piece in section.pieces)

    @property
    def mass_per_length_kg_m(self) -> float:
        """Density times the cross section."""
        return self.density_kg_m3 * math.pi / 4 * (self.outer_diameter_m**2 - self.inner_diameter_m**2)

    @property
    def length_m(self) -> float:
        """Length [m] from base to tip."""
        return math.fsum(section.length_m for section in self.sections)


@shown
@dataclass(frozen=True)
class Contact:
    """Contact of tubes i and i + 1."""

    friction_coefficient: tuple[float, float]  # lowest, highest; a number stands for both
    clearance_m: float | None = None  # radial; None: what the diameters leave

    def __post_init__(self) -> None:
        """Raises InputError unless the friction coefficient is a number or an interval."""
        read_plain_fields(self)
        given: object = self.friction_coefficient
        if isinstance(given, Real) and not isinstance(given, bool):
            object.__setattr__(self, "friction_coefficient", (float(given), float(given)))
        elif isinstance(given, list):
            object.__setattr__(self, "friction_coefficient", tuple(given))
        try:
            lowest, highest = self.friction_coefficient
            sound = 0 <= lowest <= highest < math.inf
        except (TypeError, ValueError):
            sound = False
        if not sound:
            rule = "must be a number or two, lowest and highest, from 0 upwards"
            raise InputError(rule, key="friction_coefficient", value=self.friction_coefficient)


Vector = tuple[float, float, float]


@shown
@dataclass(frozen=True)
class Loads:
    """Force [N] and moment [N m] on the innermost tip, and the acceleration [m/s^2] that gives every tube its weight.

    Vectors of three in the world frame, z along insertion. The front plate bears what reaches tube 1.
    """

    tip_force_N: Vector = ORIGIN
    tip_moment_Nm: Vector = ORIGIN
    gravity_m_s2: Vector = ORIGIN

    def __post_init__(self) -> None:
        """Raises InputError unless each is three finite numbers."""
        for entry in fields(self):
            vector = getattr(self, entry.name)
            try:
                sound = len(vector) == 3 and all(map(math.isfinite, vector))
            except TypeError:
                sound = False
            if not sound:
                raise InputError("must be three finite numbers", key=entry.name, value=vector)


# Of the base inside a tube with a compliant shaft, whose collar's angle is an unknown of its own: a node has to fit in
# between. The core asks for 0.02 mm; a little more stays above it whatever is rounded or differenced.
SHAFT_ROOM_M = 2.001e-5


def least_distance_m(outer: Tube, inner: Tube) -> float:
    """How far [m] behind the outer tube's base the inner one's has to be."""
    room = SHAFT_ROOM_M if outer.shaft_compliance_rad_per_Nm > 0 else 0.0
    return max(inner.collar_length_m, room)


def nesting_inequalities(tubes: Sequence[Tube], *, tips_in_order: bool = False) -> tuple[Array, Array]:
    """G (2n - 1, n) and h (2n - 1,) [m] such that base translations l_b nest if and only if G @ l_b <= h.

    Rows: l_1b <= 0; then for every pair the bases, l_{i+1,b} <= l_ib - collar_{i+1}, or the room that a compliant shaft
    needs; then for every pair the tips, l_ib + length_i <= l_{i+1,b} + length_{i+1}, which holds for retractable tubes
    in any case unless `tips_in_order`.
    """
    behind = np.diff(np.eye(len(tubes)), axis=0)  # row i: l_{i+1} - l_i
    apart = [-least_distance_m(*pair) for pair in pairwise(tubes)]
    longer = np.diff([tube.length_m for tube in tubes])
    longer[[tube.retractable and not tips_in_order for tube in tubes[1:]]] = np.inf
    return np.vstack([np.eye(len(tubes))[:1], behind, -behind]), np.concatenate([[0.0], apart, longer])


def reach_inequalities(tubes: Sequence[Tube]) -> tuple[Array, Array]:
    """The inequalities (2n, n), (2n,) [m] of nesting, and below them that of an outermost tip in front of the plate."""
    G, h = nesting_inequalities(tubes, tips_in_order=True)
    return np.vstack([G, -G[:1]]), np.append(h, tubes[0].length_m - 3 * ROUNDING_M)


def nests(tubes: Sequence[Tube], l_b: Array) -> NDArray[np.bool_]:
    """(K,) whether base translations (K, n) [m] nest, the outermost tip in front of the plate; on the safe side.

    The core allows for twice the rounding, and has the last word.
    """
    G, h = nesting_inequalities(tubes)
    nested: NDArray[np.bool_] = np.all(l_b @ G.T <= h + ROUNDING_M / 2, axis=1)
    return nested & (l_b[:, 0] + tubes[0].length_m > ROUNDING_M)


def moved_to_nest(tubes: Sequence[Tube], l_b: Array) -> Array:
    """Base translations (K, n) [m] with those that do not nest moved to where they do, tube by tube from outside."""
    return _ordered(tubes, l_b, [least_distance_m(*pair) for pair in pairwise(tubes)])


def is_in_order(tubes: Sequence[Tube], l_b: Array, within_m: float) -> NDArray[np.bool_]:
    """(K,) whether collars and tips of (K, n) [m] are in order within so much; room for shafts is no matter."""
    ordered = _ordered(tubes, l_b, [tube.collar_length_m for tube in tubes[1:]])
    in_order: NDArray[np.bool_] = np.abs(ordered - l_b).max(axis=1, initial=0.0) < within_m
    return in_order


def _ordered(tubes: Sequence[Tube], l_b: Array, apart_m: Sequence[float]) -> Array:
    """Base translations (K, n) moved to where tips are in order and bases `apart_m`, a distance per pair."""
    l = l_b.copy()  # noqa: E741 (as in the equations)
    l[:, 0] = np.minimum(l[:, 0], 0.0)
    for i, (outer, inner) in enumerate(pairwise(tubes)):
        if not inner.retractable:
            l[:, i + 1] = np.maximum(l[:, i + 1], l[:, i] + outer.length_m - inner.length_m)
        l[:, i + 1] = np.minimum(l[:, i + 1], l[:, i] - apart_m[i])
    return l


@dataclass(frozen=True)
class Stretch:
    """A stretch along which the same tubes, the inner ones from `first` on, have smooth precurvature."""

    begin: float
    end: float
    first: int
    u: Array  # (n, 2) precurvature at its begin [1/m]
    slope: Array  # (n, 2) per m


def stretches(tubes: tuple[Tube, ...], l_b: Array) -> list[Stretch]:
    """From the plate to the tip; where tubes end in order, the inner ones farther out."""
    breaks, ends = {0.0}, [float(l + tube.length_m) for l, tube in zip(l_b, tubes, strict=True)]  # noqa: E741
    for tube, begin in zip(tubes, l_b.tolist(), strict=True):
        at = begin
        for section in tube.pieces:
            at += section.length_m
            breaks.add(max(at, 0.0))
    results, points = list[Stretch](), sorted(breaks)
    for a, b in pairwise(points):
        if b - a < 1e-9:
            continue
        middle = (a + b) / 2
        first = next(i for i in range(len(tubes)) if max(ends[i:]) > middle and ends[i] > middle)
        pieces = [_precurvature(tube, middle - begin, a - begin) for tube, begin in zip(tubes, l_b, strict=True)]
        u, slope = (np.array(part) for part in zip(*pieces, strict=True))
        results.append(Stretch(a, b, first, u, slope))
    return results


def _precurvature(tube: Tube, inside: float, at: float) -> tuple[list[float], list[float]]:
    """Precurvature (2,) [1/m] at `at`, and its slope, of the section that `inside` lies in; lengths from the base."""
    begin = 0.0
    for section in tube.pieces:
        if begin < inside < begin + section.length_m:
            mean = np.array([section.curvature_x_per_m, section.curvature_y_per_m])
            slope = 2 * section.gradient / section.length_m
            return (mean * (1 - section.gradient + slope * (at - begin))).tolist(), (mean * slope).tolist()
        begin += section.length_m
    return [0.0, 0.0], [0.0, 0.0]


FURTHEST = 2.0  # tip from the base, in lengths of the longest tube


def farthest_m(tubes: Sequence[Tube]) -> float:
    """Distance [m] from the base beyond which no measured tip is believed."""
    return FURTHEST * max(tube.length_m for tube in tubes)
