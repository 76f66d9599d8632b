"""Where a pair touches, how hard, and how far apart its tubes are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import Shape, TubeShape
from paper_figures.pairs import OUTER_LENGTH_M

CONTACT = 0.01  # share of the largest force at which a contact point counts


class Region(NamedTuple):
    """Neighbouring contact points that push the same way."""

    s_m: float
    begin_m: float
    end_m: float
    force_N: float  # normal
    angle_rad: float


def regions(shape: Shape) -> list[Region]:
    """Of a pair, base to tip."""
    (s,), (force,), (angle,) = shape.contact_s_m, shape.contact_force_N, shape.contact_angle_rad
    loaded = np.flatnonzero(force > CONTACT * force.max())
    new = (np.diff(s[loaded]) > 4e-3) | (np.cos(np.diff(angle[loaded])) < 0)
    cores = np.split(loaded, np.flatnonzero(new) + 1)
    nearest = np.argmin([np.abs(s - s[core] @ force[core] / force[core].sum()) for core in cores], axis=0)
    return [_region(core, nearest == k, s, force, angle) for k, core in enumerate(cores)]


def _region(core: NDArray[np.intp], nearest: NDArray[np.bool_], s: Array, force: Array, angle: Array) -> Region:
    """What the core of a region pushes together with the faint forces around it; from 5 to 95 % of the force."""
    middle = float(np.angle(force[core] @ np.exp(1j * angle[core])))
    own = np.where(nearest & (np.cos(angle - middle) > 0), force, 0)
    begin, end = (float(s[np.searchsorted(np.cumsum(own), share * own.sum())]) for share in (0.05, 0.95))
    return Region(float(own @ s / own.sum()), begin, end, float(own.sum()), middle)


def couple(shape: Shape) -> tuple[float, float, float]:
    """At 180 deg: force on the tip of tube 1 [N], arm [m] of the opposite forces before it, and their couple [N m]."""
    (s,), (force,), (angle,) = shape.contact_s_m, shape.contact_force_N, shape.contact_angle_rad
    against = np.where((np.cos(angle - angle[-1]) < 0) & (s > OUTER_LENGTH_M / 3), force, 0)
    moment = float(against @ (OUTER_LENGTH_M - s))
    return float(force[-1]), moment / float(against.sum()), moment


def offset_m(shape: Shape) -> tuple[Array, Array]:
    """Arc length (N,) and offset (N,) [m, complex] of the inner tube in the outer one, the unknown d of docs/model.md.

    Integrated twice from the difference of curvatures: the two centrelines, each integrated in space by itself, differ
    from it in second order.
    """
    outer, inner = shape.tubes
    plate = int(np.searchsorted(inner.s_m, 0.0))
    s = inner.s_m[: plate + len(outer.s_m)]
    bend = curvature_vector(inner)[: len(s)]
    bend[plate + 1 :] -= curvature_vector(outer)[1:]
    near, far = bend[:-1].copy(), bend[1:]
    near[plate] = far[plate]  # the curved section begins at the plate: the value there is of the straight one
    h = np.diff(s)
    slope = np.concatenate([[0], np.cumsum(h * (near + far) / 2)])
    return s, np.concatenate([[0], np.cumsum(h * slope[:-1] + h**2 * (2 * near + far) / 6)])


def curvature_vector(tube: TubeShape) -> Array:
    """(N,) complex, twist-free frame."""
    u = tube.curvature_per_m
    vector: Array = np.exp(1j * tube.theta_rad) * (u[:, 1] - 1j * u[:, 0])
    return vector
