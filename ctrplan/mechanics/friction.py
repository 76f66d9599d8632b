"""The friction law of planning, and bodies of a configuration in many friction states.

A pair is one bristle: its friction state phi in [-1, 1] is the twist that friction holds, over the most it can hold.
Turning the inner tube's base by `loading_rad` relative to the outer one's takes phi from 0 to 1. While the tubes also
slide along each other, friction points against the slip, of which only the circumferential share holds twist:

    loading * d phi = d theta - |d l| / r * phi / sqrt(1 - phi^2),

r the radius of contact: translation by a few times `release_m` = r * loading leaves little, and a rotation at the
same time keeps tan(asin phi) = r d theta / |d l|. Pairs locked in translation are never released.

A cell's bodies are interpolated multilinearly between those of its corners. Other threads work meanwhile.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.base.arguments import Number, checked
from ctrplan.base.arrays import TINY, Array, numbers
from ctrplan.base.package import of_this_process
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import FrictionBodies, Status, input_errors
from ctrplan.mechanics.walk import SHORTEST_STEP, PathSamples

SUBSTEPS = 4  # of a leg between two waypoints
NO_SLIDE = 1e-30  # of release_m: no friction state is changed by less
NEWTON_STEPS = 50  # a budget: 3 to 8 are usual
_SHARES = np.concatenate([np.linspace(1.0, 0.02, 400), np.geomspace(0.02, 1e-9, 100)[1:]])
_COSINES = np.sqrt(1 - _SHARES**2)
# translation over release_m that takes a pair from fully loaded to each of _SHARES
_TRAVEL = np.where(_SHARES > 1e-3, np.arctanh(np.minimum(_COSINES, 1 - 1e-9)) - _COSINES, np.log(2 / _SHARES) - 1)


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """The law of a robot with P = n - 1 pairs, and how far its tips were from simulated ones when it was calibrated."""

    loading_rad: Array  # (P,) relative base rotation from unloaded to the Coulomb limit
    release_m: Array  # (P,) relative translation scale of release; inf: never
    error_rms_m: float = np.nan  # of the tip against simulated histories, over all their samples
    error_p95_m: float = np.nan  # exceeded by 5 % of the samples
    deviation_rms_m: float = np.nan  # of the simulated tips from the frictionless ones: the error of no law at all

    def advance(self, phi: Array, theta_rad: Array, l_m: Array) -> Array:
        """States (..., P) after relative rotations (..., P) [rad] and translations (..., P) [m], one implicit step."""
        return _step(phi + theta_rad / self.loading_rad, np.abs(l_m) / self.release_m)

    def follow(self, theta_b: Array, l_b: Array, phi: Array) -> Array:
        """States (K, ..., P) along waypoints (K, n) [rad], (K, n) [m], starting from phi (..., P) at the first."""
        states = [np.asarray(phi, dtype=np.float64)]
        for turn, slide in zip(np.diff(np.diff(theta_b), axis=0), np.diff(np.diff(l_b), axis=0), strict=True):
            state = states[-1]
            for _ in range(SUBSTEPS):
                state = self.advance(state, turn / SUBSTEPS, slide / SUBSTEPS)
            states.append(state)
        return np.array(states)

    def load_left(self, load: Array, theta_b: Array, l_b: Array, fraction: Array) -> Array:
        """(K, P) largest |phi| possible at fractions (K,) of a leg, given the largest possible at its start, (P,).

        The leg goes straight from row 0 to row 1 of theta_b (2, n) and l_b (2, n). Any rotation may load every pair, as
        tubes drag their neighbours; a rotation during a translation adds what it holds in the long run, which is an
        upper bound of the law.
        """
        turn = np.abs(np.diff(np.diff(theta_b), axis=0)).max(initial=0.0) / self.loading_rad
        slide = np.abs(np.diff(np.diff(l_b), axis=0)[0])
        locked = slide <= TINY
        travel = np.where(locked, 0.0, slide / self.release_m)
        locked_share = np.where(locked, 0.0, turn / np.hypot(turn, np.where(travel > 0, travel, 1.0)))
        loaded = load + fraction[:, None] * turn
        released = released_share(load, fraction[:, None] * travel) + locked_share
        left: Array = np.minimum(1.0, np.where(travel > 0, released, loaded))
        return left

    def forgets_m(self, left: float) -> Array:
        """(P,) [m] translation after which a share `left` of a full load is left; inf: never."""
        return np.asarray(self.release_m * np.interp(-left, -_SHARES, _TRAVEL))

    def unknown_after(self, load: Array, theta_b: Array, l_b: Array) -> Array:
        """(P,) half the interval of each pair's state after waypoints (K, n) [rad], (K, n) [m].

        Before them it is anywhere in [-load, load], load (P,). The law keeps the order of states, so that both ends of
        the interval say what is unknown: nothing, once they are the same.
        """
        ends = np.array([-load, load])
        for turn, slide in zip(np.diff(np.diff(theta_b), axis=0), np.diff(np.diff(l_b), axis=0), strict=True):
            travel = np.where(np.abs(slide) <= TINY, 0.0, np.abs(slide) / self.release_m)
            if np.any((travel > 0) & (turn != 0)):  # both at once: step by step
                for _ in range(SUBSTEPS):
                    ends = _step(ends + turn / self.loading_rad / SUBSTEPS, travel / SUBSTEPS)
                continue
            turned = np.clip(ends + turn / self.loading_rad, -1.0, 1.0)
            slid = np.sign(ends) * np.minimum(np.abs(ends), released_share(np.abs(ends), travel))
            ends = np.where(travel > 0, slid, turned)
        return np.asarray((ends[1] - ends[0]) / 2)


def released_share(load: Array, travel: Array) -> Array:
    """What translation by `travel` (in units of release_m) leaves of a load in [0, 1]."""
    start = np.interp(-np.asarray(load), -_SHARES, _TRAVEL)
    left: Array = np.interp(start + travel, _TRAVEL, _SHARES)
    return left


def tip_deviations(corner_tip_m: Array, tip_m: Array, phi: Array) -> Array:
    """(K, 3) [m] deviations of the tip from the frictionless one at friction states phi (K, P).

    Exact at the corners, tips (K, 2**P, 3), and at phi = 0, tips (K, 3); multilinear in phi between the corners plus a
    parabola that takes their mean to the frictionless tip.
    """
    signs = corner_signs(phi.shape[1])
    away = corner_tip_m - tip_m[:, None]
    weights = np.prod(1 + signs * phi[:, None, :], axis=2) / len(signs)
    bow = (np.mean(phi**2, axis=1) if phi.shape[1] else np.zeros(len(phi))) - 1
    deviation: Array = np.einsum("kc,kcx->kx", weights, away) + bow[:, None] * away.mean(axis=1)
    return deviation


def largest_deviation(corner_tip_m: Array, tip_m: Array, load: Array) -> Array:
    """(K,) [m] largest deviation of the tip with every |phi| at `load` (K, P), over all signs."""
    sizes = [
        np.linalg.norm(tip_deviations(corner_tip_m, tip_m, sign * load), axis=1) for sign in corner_signs(load.shape[1])
    ]
    largest: Array = np.max(sizes, axis=0)
    return largest


def released_error(samples: PathSamples, load: Array) -> Array:
    """(K,) [m] friction error at samples with every pair loaded up to load (K, n - 1); never above the bound."""
    if not samples.corner_tip_m.size:  # looked up, without a share of each pair
        highest: Array = samples.position_m * load.max(axis=1, initial=0.0)
        return highest
    return np.fmin(largest_deviation(samples.corner_tip_m, samples.tip_m, load), samples.position_m)


@cache
def corner_signs(pairs: int) -> NDArray[np.float64]:
    """(2**pairs, pairs) friction states in which every pair is fully loaded, one way or the other."""
    return np.array(list(itertools.product((1.0, -1.0), repeat=pairs))).reshape(2**pairs, pairs)


def _step(trial: Array, slide: Array) -> Array:
    """phi = sin a, sin a + slide * tan a = trial: the backward Euler step of the law; clipped where slide is 0.

    By Newton's method for u = tan a from below: u / sqrt(1 + u^2) + slide * u is concave, so that no step passes the
    root. It is at most u (1 + slide) and at most 1 + slide * u, and at most 1 up to the cube root of 1 / (4 slide).
    """
    slides = slide > NO_SLIDE
    load, s = np.where(slides, np.abs(trial), 0.0), np.where(slides, slide, 1.0)
    u = np.maximum(load / (1 + s), (load - 1) / s)
    u = np.where((load >= 1) & (s < 0.25), np.maximum(u, np.cbrt(0.25 / s)), u)
    for _ in range(NEWTON_STEPS):
        r = np.sqrt(1 + u * u)
        short = load - (u / r + s * u)
        if np.all(short <= 1e-13 * (1 + load)):
            break
        u = u + short / (1 / r**3 + s)
    phi: Array = np.copysign(np.where(slides, u / np.sqrt(1 + u * u), np.minimum(np.abs(trial), 1.0)), trial)
    return phi


# Points (K, 3) and what is asked for (K,) [m] -> clearance, exact where it is below that, else a lower bound of it.
Distance = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Doubts:
    """What is said of bodies that were not solved themselves, as shares of what is known beside them."""

    change: float  # of the difference between the bends on both sides
    bend: float  # of the bend
    spread: float  # of the largest distance of a sign corner from the frictionless body
    beyond: int  # points towards the tip whose doubt counts too


def bodies_between(
    shapes_m: Array, phi: Array, first: tuple[Array, Array], last: tuple[Array, Array], share: float, doubts: Doubts
) -> tuple[Array, Array]:
    """(S, M, 3) bodies [m] in states phi (S, P) of a configuration between two others, and (S, M) what they may be off.

    shapes_m (1 + 2^P, M, 3): solved without friction and in the sign corners. A body lies off the multilinear
    interpolation of the corners by its bend; `first` and `last` have shares of the length (N,) of the configurations
    on both sides, and their bends (S, N, 3); `share` is that of the way from the first to the last.
    """
    shares = (doubts.change, doubts.bend, doubts.spread)
    bodies, doubt = _model.bodies_between(shapes_m, phi, *first, *last, share, shares, doubts.beyond)
    return np.asarray(bodies), np.asarray(doubt)


def cell_bodies(bodies_m: Sequence[Array], radius_m: Sequence[Array], doubt_m: Sequence[Array | None]) -> Array:
    """(L, 2^P + 1, N, 4) [m] bodies of L cells and the radii around them that they may fill, as long as the longest.

    Of corners and middle, cell by cell: points (K, 3), and what they may be off by (K,), if anything; radii (K,) of a
    cell. What is too short stands at its tip for the rest, where it is already.
    """
    of_cell = len(bodies_m) // len(radius_m)
    return np.asarray(_model.cell_bodies(list(bodies_m), list(radius_m), list(doubt_m), of_cell))


def cell_spread(bodies_m: Array, beyond: int) -> tuple[Array, Array]:
    """(L, N), (L, N) [m] of L cells with bodies (L, 2^P + 1, N, 4), of corners and middle: points and radii.

    First the largest distance of the middle's body from the mean of the corners', from the base up to `beyond` points
    further out: what interpolation is off by there. Then how far a corner's surface lies at most from the middle's
    centreline, the middle's radius taken off.
    """
    off, reach = _model.cell_spread(bodies_m, beyond)
    return np.asarray(off), np.asarray(reach)


def nearest_points(
    bodies_m: Array,
    points: NDArray[np.intp],
    error_m: Array,
    enough_m: Array,
    distance: Distance,
    *,
    parts: int,
    half_m: float,
    within_m: float,
) -> tuple[Array, Array, Array]:
    """(S,) lower bounds of clearance over all states of a cell, (S, P) states there, 0 to 1 of the cell, (S, 3) where.

    Of `parts` of the body around each of K points of cells' bodies (L, 2^P + 1, N, 4), counted over all cells: S is
    parts K, part by part. Each stands for `half_m` of the body on both sides. error_m (L, N) is taken off, enough_m
    (L,) is what is asked for: less than that says only that it is not enough. States are halved along the pair
    that moves the point most, until they move it by no more than `within_m`.
    """
    search = _model.PointsInCells(bodies_m, points, error_m, enough_m, parts, half_m, within_m)
    while len(places := np.asarray(search.points())):
        search.tell(np.ascontiguousarray(distance(places, np.asarray(search.needed()))))
    least, unit, place = search.found()
    return np.asarray(least), np.asarray(unit), np.asarray(place)


@dataclass(frozen=True, eq=False)
class Branched:
    """S friction states solved from given shapes."""

    tip_m: Array  # (S, 3)
    tangent: Array  # (S, 3)
    status: NDArray[np.int_]  # (S,) Status; UNSTABLE: the robot would turn away from the solution
    stability: Array  # (S,) as that of FrictionBodies
    angles_rad: Array  # (S, n, K) of every tube where the shapes were given


SPACING = Number(SHORTEST_STEP, 1, "m")


class FrictionStates:
    """A robot at a configuration, solved without friction. Made by `Mechanics.friction_states`.

    Every state is solved from where it parts from the frictionless robot, so that its body does not depend on what else
    was asked. Thread-safe; the GIL is released.
    """

    def __init__(self, core: _model.FrictionStates, n: int) -> None:
        """core: the compiled part, of n tubes."""
        self._core, self._n = core, n

    __reduce__ = of_this_process("ask Mechanics.friction_states again")

    @checked(spacing_m=SPACING)
    def bodies(self, phi: ArrayLike, *, spacing_m: float = 1e-3) -> FrictionBodies:
        """Bodies in S friction states phi (S, n - 1), points `spacing_m` apart at most.

        Friction that differs along a contact has phi of shape (S, G, n - 1): of G equally long parts of each pair, from
        the plate to the end of its outer tube. The points are those of `check_path` with bodies: at the same arc
        lengths in every state. Raises InputError.
        """
        states = np.atleast_2d(numbers(phi, "phi"))
        states = states[:, None] if states.ndim == 2 else states
        pairs = self._n - 1
        if states.ndim != 3 or not states.shape[1] or states.shape[2] != pairs or not np.all(np.abs(states) <= 1):
            raise InputError(f"must have shape (S, {pairs}) or (S, G, {pairs}) and lie in [-1, 1]", key="phi")
        with input_errors():
            points, status, strain, stability = self._core.bodies(np.ascontiguousarray(states), float(spacing_m))
        return FrictionBodies(points[:, :, :3], points[0, :, 3], np.asarray(status) != Status.FAILED, strain, stability)
