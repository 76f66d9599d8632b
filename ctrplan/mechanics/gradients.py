"""Gradients of tips, bounds, stability, clearance and arrival by collars, base pose and numbers of the robot's file.

Numbers are named as in the robot file, values in SI units, tubes and contacts from 1, outermost first:
"tube.2.poisson_ratio", "contact.1.friction_coefficient"; and collars "theta_b.1" and "l_b.3".

A gradient is that of the discretised equations, whose mesh moves with the tubes. A quantity has none where the number
of elements changes, where another corner or another point of the body becomes the worst, where tubes are about to snap,
and where collars, joints or tips coincide: there it is the derivative of the active branch. It is NaN where there is
none to follow: where a solve failed, a number can't be moved by itself, or a compliant shaft is rigid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import no_such_number
from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.mechanics.friction import corner_signs
from ctrplan.mechanics.shapes import BY, Accuracy, Bound, BoundGradient, FrictionBodies, Gradient, Status, Tips
from ctrplan.mechanics.tube import Tube

POINT_STEP_M = 1e-6  # of a point, across which the clearance there is differenced: a distance, so that it is smooth
LONG_M = 1.0  # between points of a body of which none is wanted
SAME_M = 1e-6  # by which a tip may be off the shape that it belongs to: more, and it is another equilibrium's

Direction = tuple[list[int], list[float], float]  # numbers of the core, derivatives by the parameter, step

STEPS = {  # small against what the number usually is; differences across it are exact to about its square
    "softening_strain": 1e-8,
    "length": 1e-8,
    "l_b": 1e-8,
    "clearance": 1e-11,  # against the gap that is left in contact
    "tip_moment": 1e-6,
    "gravity": 1e-3,
}
DIRECT = {  # keys that are a number of the core as they stand
    "curvature_x_per_m": "curvature_x",
    "curvature_y_per_m": "curvature_y",
    "length_m": "length",
    "gradient": "gradient",
    "ovality": "ovality",
    "ovality_axis_rad": "ovality_axis",
    "softening_strain": "softening_strain",
    "softening_fraction": "softening_fraction",
    "shaft_compliance_rad_per_Nm": "shaft_compliance",
    "clearance_m": "clearance",
    "friction_coefficient": "friction",
    "tip_force_N": "tip_force",
    "tip_moment_Nm": "tip_moment",
    "gravity_m_s2": "gravity",
}


def directions(names: Sequence[str], tubes: Sequence[Tube], numbers: Sequence[str]) -> list[Direction]:
    """For each name its direction in the core's numbers. Raises InputError for a name that does not exist."""
    index = {number: k for k, number in enumerate(numbers)}
    return [_direction(name, tubes, index) for name in names]


def _direction(name: str, tubes: Sequence[Tube], index: dict[str, int]) -> Direction:
    parts = name.split(".")
    kind = parts[0]
    tube = _tube(parts, tubes, name) if kind == "tube" else None
    if tube is not None and parts[2:] == ["bending_stiffness_Nm2"]:  # at constant Poisson's ratio
        weights = {f"{kind}.{parts[1]}.bending_stiffness": 1.0}
        weights[f"{kind}.{parts[1]}.torsional_stiffness"] = 1 / (1 + tube.poisson_ratio)
        step = 1e-6 * tube.bending_stiffness_Nm2
    elif tube is not None and parts[2:] == ["poisson_ratio"]:
        slope = -tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio) ** 2
        weights, step = {f"tube.{parts[1]}.torsional_stiffness": slope}, 1e-6
    elif tube is not None and parts[2:] == ["density_kg_m3"]:
        area = math.pi / 4 * (tube.outer_diameter_m**2 - tube.inner_diameter_m**2)
        weights, step = {f"tube.{parts[1]}.mass_per_length": area}, 1.0
    elif tube is not None and parts[2] == "section" and len(parts) > 4 and tube.pieces != tube.sections:
        weights, step = _of_pieces(parts, tube), _step(DIRECT.get(parts[4], parts[4]))
    else:
        number = ".".join("pair" if part == "contact" else DIRECT.get(part, part) for part in parts)
        weights, step = {number: 1.0}, _step(number)
    missing = [number for number in weights if number not in index]
    if missing:
        raise no_such_number(name, (*DIRECT, "poisson_ratio", "bending_stiffness_Nm2", "density_kg_m3"))
    return [index[number] for number in weights], list(weights.values()), step


def _of_pieces(parts: list[str], tube: Tube) -> dict[str, float]:
    """Numbers of the pieces of a tube, some of whose cells are bent, and their derivatives by that of a section."""
    k, key = int(parts[3]), parts[4]
    section, first = tube.sections[k - 1], 1 + sum(len(each.pieces) for each in tube.sections[: k - 1])
    weights: dict[str, float] = {}
    for j, ((begin, end), piece) in enumerate(zip(pairwise(section.cuts), section.pieces, strict=False), start=first):
        number, share, factor = (
            f"tube.{parts[1]}.section.{j}",
            (end - begin) / section.cells,
            section.factor(begin, end),
        )
        drawn = {"x": section.curvature_x_per_m, "y": section.curvature_y_per_m}
        if key == "cell" and (begin, end) == (int(parts[5]) - 1, int(parts[5])):
            weights[f"{number}.curvature_{parts[6][0]}"] = 1 / piece.length_m
        elif key in ("curvature_x_per_m", "curvature_y_per_m"):
            weights[f"{number}.{DIRECT[key]}"] = factor
        elif key == "length_m":
            weights[f"{number}.length"] = share
            for axis, rate in (("x", piece.curvature_x_per_m), ("y", piece.curvature_y_per_m)):
                weights[f"{number}.curvature_{axis}"] = (factor * drawn[axis] - rate) / section.length_m
        elif key == "gradient":
            weights |= {
                f"{number}.curvature_{axis}": rate * (begin + end - section.cells) / section.cells
                for axis, rate in drawn.items()
            }
            weights[f"{number}.gradient"] = share / factor**2 if factor else 0.0
    return weights


def _tube(parts: list[str], tubes: Sequence[Tube], name: str) -> Tube:
    if len(parts) < 3 or not parts[1].isdecimal() or not 1 <= int(parts[1]) <= len(tubes):
        raise no_such_number(name, (*DIRECT, "poisson_ratio", "bending_stiffness_Nm2", "density_kg_m3"))
    return tubes[int(parts[1]) - 1]


def _step(number: str) -> float:
    for part in number.split("."):
        if part in STEPS:
            return STEPS[part]
    return 1e-5


class Differentiable(Protocol):
    """What gradients are made of: `ctrplan.mechanics.core.Mechanics`."""

    n: int

    @property
    def numbers(self) -> tuple[tuple[Tube, ...], list[str]]:
        """Tubes, and what the core calls its numbers."""

    def tips_with_friction(
        self,
        theta_b: Array,
        l_b: Array,
        phi: Array,
        *,
        parameters: Sequence[str],
        threads: int = 0,
        accuracy: Accuracy = "search",
    ) -> Tips:
        """Tips of (K, n), (K, n) in states (K, n - 1), and their derivatives."""

    def friction_bodies(self, theta_b: Array, l_b: Array, phi: Array, *, spacing_m: float) -> FrictionBodies:
        """Bodies in friction states (S, n - 1) at (n,), (n,)."""

    def core_body(
        self, theta_b: Array, l_b: Array, phi: Array, names: Sequence[str], accuracy: Accuracy, spacing_m: float
    ) -> tuple[Array, Array, float, Array]:
        """A body and its stability, and their derivatives."""


def collar_names(n: int) -> list[str]:
    """What the collars of n tubes are called: rotations, then translations."""
    return [f"{kind}.{i + 1}" for kind in ("theta_b", "l_b") for i in range(n)]


def _gradient(value: Array, by: Array, n: int) -> Gradient:
    """The gradient of a quantity (...) from its derivatives (..., 2 n + P) by collars, then parameters."""
    return Gradient(value, by[..., :n], by[..., n : 2 * n], by[..., 2 * n :])


def tip_gradient(
    mechanics: Differentiable, theta_b: Array, l_b: Array, phi: Array, parameters: Sequence[str], accuracy: Accuracy
) -> Gradient:
    """The tip (3,) [m] at (n,), (n,) in a friction state (n - 1,), in the robot's frame. Raises InputError."""
    names = [*collar_names(mechanics.n), *parameters]
    tips = mechanics.tips_with_friction(theta_b[None], l_b[None], phi[None], parameters=names, accuracy=accuracy)
    result = _gradient(tips.position_m[0], tips.position_by[0], mechanics.n)
    return result.lost() if tips.status[0] == Status.FAILED else result


def bound_gradients(
    mechanics: Differentiable,
    theta_b: Array,
    l_b: Array,
    corner_phi: Array,
    parameters: Sequence[str],
    *,
    accuracy: Accuracy,
    threads: int = 0,
) -> BoundGradient:
    """At K configurations (K, n), (K, n) that nest, over corners (C, n - 1). Raises InputError."""
    if accuracy == "exact":
        raise InputError('has no gradient: "search" and "certificate" have', key="accuracy", value=accuracy)
    n, count, names = mechanics.n, len(theta_b), [*collar_names(mechanics.n), *parameters]
    states = np.vstack([np.zeros(n - 1), corner_phi])
    thetas, ls = (np.repeat(part, len(states), axis=0) for part in (theta_b, l_b))
    phi = np.tile(states, (count, 1))
    tips = mechanics.tips_with_friction(thetas, ls, phi, parameters=names, accuracy=accuracy, threads=threads)
    lost = np.any(tips.status.reshape(count, -1) == Status.FAILED, axis=1)
    shape, every = (count, len(states), 3), np.arange(count)
    tip, tangent = (
        _gradient(np.where(lost[:, None, None], np.nan, value.reshape(shape)), by.reshape(*shape, len(names)), n)
        for value, by in ((tips.position_m, tips.position_by), (tips.tangent, tips.tangent_by))
    )
    released = tip.at((slice(None), 0))
    size = np.linalg.norm(tip.value[:, 1:] - tip.value[:, :1], axis=2)
    farthest = 1 + np.argmax(np.nan_to_num(size), axis=1)
    position = tip.at((every, farthest)).less(released).distance_from(np.zeros(3))
    angle = _turned(tangent.at((slice(None), slice(1, None))), tangent.at((slice(None), slice(0, 1))))
    turned = angle.at((every, np.argmax(np.nan_to_num(angle.value), axis=1)))
    stability, by = np.full(count, np.nan), np.full((count, len(names)), np.nan)
    with ThreadPoolExecutor(threads or cores()) as pool:
        own = pool.map(partial(_stability, mechanics, names, accuracy), theta_b, l_b)
        for k, (value, slopes) in enumerate(own):
            stability[k], by[k] = value, slopes
    return BoundGradient(position, turned, _gradient(stability, by, n), released)


def _turned(u: Gradient, v: Gradient) -> Gradient:
    """Angles [rad] (...) between unit vectors (..., 3); zero derivatives where they are alike."""
    normal = np.cross(v.value, u.value)
    sine, cosine = np.linalg.norm(normal, axis=-1), np.sum(u.value * v.value, axis=-1)
    normal = normal / np.where(sine > 0, sine, 1.0)[..., None]
    angle = np.arctan2(sine, cosine)
    first, second = u.along(np.cross(normal, u.value), angle), v.along(np.cross(v.value, normal), angle)
    return Gradient(angle, *(getattr(first, key) + getattr(second, key) for key in BY))


def _stability(
    mechanics: Differentiable, names: Sequence[str], accuracy: Accuracy, theta_b: Array, l_b: Array
) -> tuple[float, Array]:
    """Stability of the frictionless shape at (n,) [rad], (n,) [m], and its derivatives (P,) by the names."""
    state = np.zeros(mechanics.n - 1)
    _, _, stability, by = mechanics.core_body(theta_b, l_b, state, names, accuracy, LONG_M)
    return stability, by


def with_gradient(
    mechanics: Differentiable, bound: Bound, theta_b: Array, l_b: Array, parameters: Sequence[str], accuracy: Accuracy
) -> Bound:
    """A bound at (n,), (n,) with its gradient: NaN where it is of shapes that other ways of solving do not lead to."""
    gradients = bound_gradients(mechanics, theta_b[None], l_b[None], bound.corner_phi, parameters, accuracy=accuracy)
    row = gradients.each(lambda of: of.at(0))
    if not abs(row.position_m.value - bound.position_m) < SAME_M:
        row = row.each(Gradient.lost)
    return replace(bound, gradient=row)


@shown
@dataclass(frozen=True, eq=False)
class Clearances:
    """The clearance that K states leave to the anatomy, and its derivatives where they were asked for, else None.

    It is the exact distance of the nearest body point to the anatomy, over the frictionless shape and those of all
    corners, less the outer radius and the anatomy's margins. Points are `PathDensity.point_spacing_m` apart at most.
    """

    clearance_m: Array  # (K,) inf in free space, NaN where a shape has no solution or the state is out of limits
    phi: Array  # (K, n - 1) friction state of the shape that is nearest
    point_m: Array  # (K, 3) its point that is, on the centreline, in the anatomy's frame
    by_joints: Array | None = None  # (K, m) m per rad or m
    by_base_position: Array | None = None  # (K, 3) m per m that the base is displaced, in the anatomy's frame
    by_base_rotation: Array | None = None  # (K, 3) m per rad of a rotation about the base's origin, in that frame
    by_parameters: Array | None = None  # (K, P) m per SI unit

    def headline(self) -> str:
        """The least of them."""
        return f"of {len(self.clearance_m)} states, at least {1e3 * np.min(self.clearance_m, initial=np.inf):.3g} mm"


Clearance = Callable[[Array], Array]  # (N,) [m] that the anatomy leaves to points (N, 3) [m] of its frame


def clearances(
    mechanics: Differentiable,
    collars: tuple[Array, Array],
    moves: Array | None,
    base: tuple[Array, Array],
    clearance: Clearance,
    *,
    spacing_m: float,
    kept: NDArray[np.bool_],
    parameters: Sequence[str] = (),
    threads: int = 0,
) -> Clearances:
    """At K configurations (K, n), (K, n); those that are not `kept` (K,) are not looked at.

    moves: how collars change with joints, (K, 2 n, m), or None for clearances without derivatives. base: rotation
    (3, 3) and place (3,) of the robot in the anatomy's frame. Raises InputError.
    """
    n, names = mechanics.n, [*collar_names(mechanics.n), *parameters]
    directions(names, *mechanics.numbers)  # refuses what is no parameter, whatever the rows
    rows = np.full((len(kept), n + 3 + (0 if moves is None else 6 + len(names))), np.nan)
    nearest = partial(_nearest, mechanics, base, clearance, spacing_m, None if moves is None else names)
    with ThreadPoolExecutor(threads or cores()) as pool:
        for k, row in zip(
            np.flatnonzero(kept).tolist(), pool.map(nearest, *(part[kept] for part in collars)), strict=True
        ):
            rows[k] = row
    value, phi, point = rows[:, 0], rows[:, 1:n], rows[:, n : n + 3]
    if moves is None:
        return Clearances(value, phi, point)
    by = _gradient(value, rows[:, n + 9 :], n)
    joints = np.where(np.isnan(value)[:, None], np.nan, by.by_joints(moves))
    return Clearances(value, phi, point, joints, rows[:, n + 3 : n + 6], rows[:, n + 6 : n + 9], by.parameters)


def _nearest(
    mechanics: Differentiable,
    base: tuple[Array, Array],
    clearance: Clearance,
    spacing_m: float,
    names: Sequence[str] | None,
    theta_b: Array,
    l_b: Array,
) -> Array:
    """Clearance, friction state and place of the body point that has least of all shapes at (n,), (n,).

    With P names, then its derivatives by a displacement and a rotation of the base, and by the names. NaN where a shape
    has no solution.
    """
    (R, place), states = base, np.vstack([np.zeros(mechanics.n - 1), corner_signs(mechanics.n - 1)])
    bodies = mechanics.friction_bodies(theta_b, l_b, states, spacing_m=spacing_m)
    if not bodies.solved.all():
        return np.full(mechanics.n + 3 + (0 if names is None else 6 + len(names)), np.nan)
    located = bodies.point_m @ R.T + place
    room = clearance(located.reshape(-1, 3)).reshape(len(states), -1) - bodies.radius_m
    state, k = divmod(int(np.argmin(room)), room.shape[1])
    if names is None:
        return np.concatenate([[room[state, k]], states[state], located[state, k]])
    points, by, _, _ = mechanics.core_body(theta_b, l_b, states[state], names, "search", spacing_m)
    own = points[:, :3] @ R.T + place
    left = clearance(own) - points[:, 3]
    k = int(np.argmin(left))
    steps = POINT_STEP_M * np.eye(3)
    beside = clearance(np.concatenate([own[k] + steps, own[k] - steps]))
    slope = (beside[:3] - beside[3:]) / (2 * POINT_STEP_M) if np.isfinite(left[k]) else np.zeros(3)
    turn = np.cross(own[k] - place, slope)
    return np.concatenate([[left[k]], states[state], own[k], slope, turn, (slope @ R) @ by[k]])
