"""What the mechanics answers: shapes, bounds, points of tubes and moments at the plate. SI units, world frame at the
plate.

Between two stations a tube is nearly a helix: the screw motion that takes one frame to the next. What is left of the
tangents at both ends is added as a cubic (Hermite). Of a section of constant curvature this is exact.

In front of the plate the tubes balance each other. Behind it they are guided straight: each curved section there bears
on the guide with its stiffness times its precurvature. Across the guide's length that is a mean.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan import _model
from ctrplan.base.arguments import Number, checked
from ctrplan.base.arrays import ROUNDING_M, Array
from ctrplan.base.package import shown
from ctrplan.errors import InputError, SolverError
from ctrplan.mechanics.tube import Tube

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Accuracy = Literal["search", "certificate", "exact"]
"""Mesh error of a tip on the Table III grid: 0.3, 0.05 mm; "exact" also drops the first order in the clearance."""


@checked(
    breakaway_m=Number(1e-7, 0.1, "m"),
    rotation_rad=Number(1e-4, 1, "rad"),
    translation_m=Number(1e-6, 0.1, "m"),
    state_change=Number(1e-4, 1),
)
@dataclass(frozen=True)
class HistoryOptions:
    """How a history is stepped; halving the steps moves no tip by more than 0.05 mm (benchmarks/history.py)."""

    breakaway_m: float = 0.02e-3  # slip over which friction builds up
    rotation_rad: float = 0.05  # longest step of a tube base
    translation_m: float = 0.5e-3
    state_change: float = 0.05  # of phi, mean over the contacts weighted by force, aimed at in a step


# Of paths that a search compares, and of histories that no tip has told apart: what follows corrects them. They take
# 0.6 to 0.7 of the time, 95 % of tips are within 0.05 mm (`history numerics` of benchmarks/run.py).
LONG_STEPS = HistoryOptions(rotation_rad=0.15, translation_m=1.5e-3, state_change=0.1)


@contextmanager
def input_errors() -> Iterator[None]:
    """Turns the core's refusals into InputError, and that it got no memory into SolverError."""
    try:
        yield
    except _model.InvalidInput as refusal:
        raise InputError(str(refusal)) from None
    except MemoryError:
        raise SolverError("there is not enough memory for so many solves at once") from None


# What a Shape has along its tubes
ALONG = frozenset({"tubes", "radius_m", "contact_s_m", "contact_force_N", "contact_angle_rad", "max_strain"})


class Status(enum.IntEnum):
    """What a solve found; nothing else promises a tip."""

    CONVERGED = 0  # residual reached, stable
    MULTIPLE = 1  # as CONVERGED, and another stable solution is known
    UNSTABLE = 2  # an equilibrium, but not a minimum of the energy: the robot would snap away from it
    FAILED = 3  # residual not reached
    # as FAILED, of single shapes only: on the way to its equilibrium friction at its full limit twists a tube by a
    # shear strain of more than 0.5, several times what any tube bears
    OVERTWISTED = 4
    REFUSED = 5  # of batches only: not solved, collars that do not nest or are no numbers


@shown
@dataclass(frozen=True, eq=False)
class TubeShape:
    """One tube from its collar to its tip, N stations."""

    s_m: Array  # (N,) arc length from the front plate
    centreline_m: Array  # (N, 3) world frame
    frames: Array  # (N, 3, 3) material frames, columns are the axes in the world frame
    theta_rad: Array  # (N,) material angle against the tube's twist-free frame
    curvature_per_m: Array  # (N, 3) rotation rate u in the material frame
    strain: Array  # (N,) largest bending strain r_out |u_xy - u_hat_xy|


@shown
@dataclass(frozen=True, eq=False)
class Shape:
    """An equilibrium of the robot; the centreline is the innermost tube's."""

    tubes: tuple[TubeShape, ...]  # outermost first
    radius_m: Array  # (N,) outer radius of what is there, at s_m
    contact_s_m: tuple[Array, ...]  # per pair: stations of possible contacts
    contact_force_N: tuple[Array, ...]  # per pair: normal force at each station, a discretised distribution
    contact_angle_rad: tuple[Array, ...]  # per pair: where the inner tube leans, twist-free frame
    status: Status
    residual: float  # largest imbalance of moments over the robot's own, EI * precurvature
    # smallest eigenvalue of the torsional second variation over GJ / L^2 of the innermost tube; NaN along histories.
    # Whatever phi is, that of the frictionless shape: walks and bodies in friction states count friction.
    stability: float
    max_strain: float
    equilibrium: _model.Equilibrium | None = field(default=None, repr=False)  # what the core kept of the solution

    def headline(self) -> str:
        """Tip and status of the shape, shown where it is printed."""
        tip = ", ".join(f"{x:.4g}" for x in (self.tip_m * 1e3).tolist())
        return f"tip at ({tip}) mm, {Status(self.status).name}"

    def plot(self) -> Figure:
        """The shape in front of the plate, a colour for each tube."""
        import ctrplan  # pictures are of a package above, and stand in the public names

        return ctrplan.plot(self)

    def recheck(self) -> float:
        """`residual` evaluated anew by the core, from theta_rad and contact_force_N as they stand here.

        Offsets and friction are those that were solved for. Of the zero-clearance model all unknowns are. Raises
        InputError for arrays of other lengths, and for a shape that was unpickled, which keeps no solution.
        """
        if self.equilibrium is None:
            raise InputError("keeps no solution that could be checked again", key="shape")
        with input_errors():
            return self.equilibrium.residual([tube.theta_rad for tube in self.tubes], self.contact_force_N)

    @classmethod
    def of_core(cls, kept: _model.Shape, status: Status) -> Shape:
        """What the core keeps of a shape; what it has along its tubes is made when somebody looks at it."""
        shape = cls.__new__(cls)
        vars(shape).update(
            status=status,
            residual=kept.residual,
            stability=kept.stability,
            equilibrium=kept.equilibrium,
            _kept=kept,
        )
        return shape

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """What nobody has looked at before."""
            kept = vars(self).get("_kept")
            if kept is None or name not in ALONG:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            result = tuple(TubeShape(**tube) for tube in kept.tubes()) if name == "tubes" else getattr(kept, name)
            return vars(self).setdefault(name, result)

    def __getstate__(self) -> dict[str, Any]:
        """All fields but the solution, which lives in this process."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "equilibrium"}

    @property
    def s_m(self) -> Array:
        """(N,) arc length of the innermost tube from the front plate."""
        return self.tubes[-1].s_m

    @property
    def centreline_m(self) -> Array:
        """(N, 3) innermost tube, world frame."""
        return self.tubes[-1].centreline_m

    @property
    def tip_m(self) -> Array:
        """(3,) tip of the innermost tube, world frame."""
        kept = vars(self).get("_kept")
        tip: Array = self.centreline_m[-1] if kept is None else kept.tip_m
        return tip

    @property
    def tip_tangent(self) -> Array:
        """(3,) unit tangent at the tip, world frame."""
        kept = vars(self).get("_kept")
        tangent: Array = self.tubes[-1].frames[-1, :, 2] if kept is None else kept.tip_tangent
        return tangent


BY = ("theta_b", "l_b", "parameters")  # what there are derivatives by


@shown
@dataclass(frozen=True, eq=False)
class Gradient:
    """A quantity of any shape and its derivatives; `...` stands for the quantity's own axes."""

    value: Array  # (...)
    theta_b: Array  # (..., n) per rad of each collar
    l_b: Array  # (..., n) per m
    parameters: Array  # (..., P) per SI unit of each parameter, in the order in which they were named

    def headline(self) -> str:
        """What it is of."""
        return f"of {self.value.size} numbers by {2 * self.theta_b.shape[-1]} collars"

    def by_joints(self, moves: Array) -> Array:
        """(..., m) by actuated joints, per rad or m of each; moves: `Drive.collars_by_joints` (2 n, m) or (K, 2 n, m).

        A collar that can't be moved by itself counts as fixed.
        """
        by = np.nan_to_num(np.concatenate([self.theta_b, self.l_b], axis=-1))
        by = by[..., None, :] if by.ndim == 1 or moves.ndim == 3 and by.ndim == 2 else by
        joints: Array = by @ moves
        return joints.reshape(*self.value.shape, -1)

    def distance_from(self, point: Array) -> Gradient:
        """The distance [m] of a point (..., 3) from a fixed one (3,); zero derivatives where they coincide."""
        away = self.value - point
        size = np.linalg.norm(away, axis=-1)
        return self.along(away / np.where(size > 0, size, 1.0)[..., None], size)

    def along(self, unit: Array, value: Array) -> Gradient:
        """What changes by unit . change of this quantity, (..., 3) each, and has a value (...)."""
        columns = (np.einsum("...i,...ij->...j", unit, getattr(self, key)) for key in BY)
        return Gradient(value, *columns)

    def at(self, rows: Any) -> Gradient:
        """Some rows of the quantity."""
        return Gradient(*(getattr(self, each.name)[rows] for each in fields(self)))

    def less(self, other: Gradient) -> Gradient:
        """The difference of two quantities of one shape."""
        return Gradient(*(getattr(self, each.name) - getattr(other, each.name) for each in fields(self)))

    def lost(self) -> Gradient:
        """NaN in its place."""
        return Gradient(*(np.full_like(getattr(self, each.name), np.nan) for each in fields(self)))

    def scattered(self, kept: NDArray[np.bool_]) -> Gradient:
        """The gradient's K rows where `kept` (L,) is true, and NaN in all others."""
        columns = []
        for each in fields(self):
            values = getattr(self, each.name)
            columns.append(np.full((len(kept), *values.shape[1:]), np.nan))
            columns[-1][kept] = values
        return Gradient(*columns)


@shown
@dataclass(frozen=True, eq=False)
class BoundGradient:
    """How a bound and what belongs to it change. None of it knows where the base stands.

    Values are those of the solution to its last digits, which the bound's own are within 1e-9 m of. Of K configurations
    every quantity has K rows.
    """

    position_m: Gradient  # () bound of the tip, in the worst corner
    tangent_rad: Gradient  # () that of the tip tangent
    stability: Gradient  # () of the frictionless shape
    tip_m: Gradient  # (3,) frictionless, in the robot's frame

    def headline(self) -> str:
        """How large."""
        return f"of {self.position_m.value.size} bounds by {2 * self.position_m.theta_b.shape[-1]} collars"

    def each(self, change: Callable[[Gradient], Gradient]) -> BoundGradient:
        """A copy in which `change` was made of every quantity's gradient."""
        return BoundGradient(*(change(getattr(self, name.name)) for name in fields(self)))


@shown
@dataclass(frozen=True, eq=False)
class Bound:
    """Largest deviations that friction can cause, over sign corners, from the frictionless clearance solution."""

    position_m: float  # of the tip
    tangent_rad: float  # of the tip tangent
    frictionless: Shape  # phi = 0
    corners: tuple[Shape, ...]  # those visited: all, phi in itertools.product((1, -1), repeat=n - 1), or extreme ones
    corner_phi: Array  # (C, n - 1) friction states of the corners, signs per pair, outermost first
    envelope_m: Array  # (N,) of the centreline, at frictionless.s_m
    worst_corner: int  # index of the corner that gives position_m
    gradient: BoundGradient | None = field(default=None, repr=False)  # if asked for

    def headline(self) -> str:
        """How far friction may move the tip, as it shows itself."""
        moved, turned = self.position_m * 1e3, np.degrees(self.tangent_rad)
        return f"friction may move the tip by {moved:.3g} mm and turn it by {turned:.3g} deg"

    def plot(self) -> Figure:
        """The frictionless shape among the corner shapes, and the envelope along the robot."""
        import ctrplan  # pictures are of a package above, and stand in the public names

        return ctrplan.plot(self)

    @property
    def has_all_corners(self) -> bool:
        """Whether every corner was visited; of extreme ones alone the bound is what a search found."""
        return len(self.corners) == 1 << int(self.corner_phi.shape[1])


@shown
@dataclass(frozen=True, eq=False)
class Bounds:
    """`Bound` for K configurations, without the shapes.

    Bounds are NaN where any of the solves failed, all else but residual and status where the frictionless one did.
    """

    position_m: Array  # (K,)
    tangent_rad: Array  # (K,)
    stability: Array  # (K,)
    max_strain: Array  # (K,)
    residual: Array  # (K,)
    status: NDArray[np.int_]  # (K,) values of Status
    tip_m: Array  # (K, 3) frictionless
    tip_tangent: Array  # (K, 3)
    gradient: BoundGradient | None = field(default=None, repr=False)  # of all rows, if asked for


@shown
@dataclass(frozen=True, eq=False)
class Tips:
    """Tips of K friction states and their derivatives by P parameters, per unit of each in SI units."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    status: NDArray[np.int_]  # (K,) Status; UNSTABLE: the robot would turn away from the solution
    residual: Array  # (K,)
    max_strain: Array  # (K,)
    position_by: Array  # (K, 3, P)
    tangent_by: Array  # (K, 3, P)


@shown
@dataclass(frozen=True, eq=False)
class FrictionBodies:
    """The outermost centreline in front of the plate in S friction states, N points at the same arc lengths."""

    point_m: Array  # (S, N, 3)
    radius_m: Array  # (N,) outer radius of what is there
    solved: NDArray[np.bool_]  # (S,)
    max_strain: Array  # (S,) over all tubes
    stability: Array  # (S,) eigenvalue of the Newton matrix nearest to zero over GJ / L^2, friction included


SMALL_RAD = 1e-4  # rotations below which series take the place of quotients


def points_on_tubes(tubes: Sequence[TubeShape], s_m: Sequence[float] | Array) -> tuple[Array, Array]:
    """Centrelines (N, 3) [m] and unit tangents (N, 3) of N tubes, each at an arc length (N,) [m] from the plate.

    NaN where the tube is not.
    """
    point, tangent = np.full((2, len(tubes), 3), np.nan)
    places, brackets = list[int](), list[tuple[Array, Array, Array, Array, float, float]]()
    for k, (tube, at) in enumerate(zip(tubes, s_m, strict=True)):
        s = tube.s_m
        if not len(s) or not s[0] - ROUNDING_M <= at <= s[-1] + ROUNDING_M:
            continue
        i = min(max(int(s.searchsorted(at)) - 1, 0), len(s) - 2)
        x = min(max(float((at - s[i]) / (s[i + 1] - s[i])), 0.0), 1.0)
        if x in (0.0, 1.0):
            point[k], tangent[k] = tube.centreline_m[i + int(x)], tube.frames[i + int(x), :, 2]
        else:
            ends = tube.centreline_m[i], tube.frames[i], tube.centreline_m[i + 1], tube.frames[i + 1]
            brackets.append((*ends, float(s[i + 1] - s[i]), x))
            places.append(k)
    if places:
        columns = (np.array(column) for column in zip(*brackets, strict=True))
        point[places], tangent[places] = _between(*columns)
    return point, tangent


def _between(p: Array, R: Array, p_next: Array, R_next: Array, h: Array, x: Array) -> tuple[Array, Array]:
    """Points (N, 3) and unit tangents (N, 3) at shares x (N,) of elements of length h (N,) between two stations."""
    from scipy.spatial.transform import Rotation  # slow to import

    back = R.transpose(0, 2, 1)
    w, share = Rotation.from_matrix(back @ R_next).as_rotvec(), x[:, None]
    v = np.linalg.solve(_swept(w), np.einsum("nij,nj->ni", back, p_next - p)[:, :, None])[:, :, 0]
    left = (
        h[:, None] * np.array([0.0, 0.0, 1.0]) - v
    )  # of the tangent at one end, and turned with the frame at the other
    right = Rotation.from_rotvec(w).apply(left)
    way = share * np.einsum("nij,nj->ni", _swept(share * w), v) + share * (1 - share) * (
        (1 - share) * left - share * right
    )
    along = Rotation.from_rotvec(share * w).apply(v)
    along = along + (1 - share) * (1 - 3 * share) * left - share * (2 - 3 * share) * right
    along = np.einsum("nij,nj->ni", R, along)
    return p + np.einsum("nij,nj->ni", R, way), along / np.linalg.norm(along, axis=1, keepdims=True)


def _swept(w: Array) -> Array:
    """(N, 3, 3) integrals of the rotations by x w, x from 0 to 1."""
    angle = np.linalg.norm(w, axis=1)
    large = np.maximum(angle, SMALL_RAD)
    first = np.where(angle < SMALL_RAD, 0.5 - angle**2 / 24, (1 - np.cos(large)) / large**2)
    second = np.where(angle < SMALL_RAD, 1 / 6 - angle**2 / 120, (large - np.sin(large)) / large**3)
    W = np.zeros((len(w), 3, 3))
    W[:, [2, 0, 1], [1, 2, 0]], W[:, [1, 2, 0], [2, 0, 1]] = w, -w
    swept: Array = np.eye(3) + first[:, None, None] * W + second[:, None, None] * W @ W
    return swept


GUIDE_M = 10e-3  # of the plate, behind its front


def plate_moment(tubes: Sequence[Tube], theta_b: Array, l_b: Array) -> Array:
    """(K, 2) [N m] about x and y on the guide, with collars at (K, n) [rad] and (K, n) [m]; zero of straight tubes."""
    moment = np.zeros((len(theta_b), 2))
    for i, tube in enumerate(tubes):
        cosine, sine = np.cos(theta_b[:, i]), np.sin(theta_b[:, i])
        begin = l_b[:, i]
        for section in tube.pieces:
            end = begin + section.length_m
            inside = np.clip(np.minimum(end, 0.0) - np.maximum(begin, -GUIDE_M), 0.0, None) / GUIDE_M
            size = tube.bending_stiffness_Nm2 * inside
            x, y = section.curvature_x_per_m, section.curvature_y_per_m
            moment += size[:, None] * np.column_stack([cosine * x - sine * y, sine * x + cosine * y])
            begin = end
    return moment


def largest_plate_moment(tubes: Sequence[Tube]) -> float:
    """[N m] that no configuration exceeds."""
    return sum(t.bending_stiffness_Nm2 * max(section.curvature_per_m for section in t.pieces) for t in tubes)
