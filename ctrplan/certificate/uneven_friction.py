"""How much nearer to the anatomy a robot may come where friction differs along the contact of a pair.

Friction states have one number per pair. A history may leave another friction at every place. Each pair's contact is
cut into parts. From the narrowest uniform state on, friction of every part of every pair is changed both ways, and all
that brings the body nearer is changed together, in ever smaller steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.friction_states import POINT_SPACING_M, UNEVEN_FRICTION_M
from ctrplan.certificate.narrow_samples import narrow_places
from ctrplan.certificate.walked_piece import Piece
from ctrplan.motion.limits import path_limits

if TYPE_CHECKING:
    from ctrplan.mechanics.friction import FrictionStates
    from ctrplan.scenario.scenario import Scenario

PARTS = 6  # of each pair's contact
GRID = 5  # uniform states along each pair to begin with
STEP, LEAST_STEP = 1.0, 1 / 16  # of friction states
WORTH_M = 1e-6  # of a step that is taken
NEAR_LIMIT_M = 0.5e-3  # of what has to be clear: samples that uneven friction might break


@dataclass(frozen=True)
class Uneven:
    """The worst that was found at a configuration."""

    nearer_m: float  # than the nearest uniform state
    phi: Array  # (PARTS, P)


def worst_uneven_friction(distance: AnatomyDistance, theta_b: Array, l_b: Array) -> Uneven:
    """At collars (n,); 0 m where no uneven state comes nearer than a uniform one, or none was solved."""

    at = distance.scenario.robot.mechanics.friction_states(theta_b, l_b)

    def clearances(states: Array) -> Array:
        return _clearances(distance, at, states)

    pairs = len(l_b) - 1
    grid = _uniform(pairs)
    least = clearances(grid)
    uniform, phi = _nearest(clearances, grid[int(np.argmin(least))], float(least.min()), _of_whole_pairs(pairs))
    uneven, phi = _nearest(clearances, phi, uniform, _of_parts(pairs))
    return Uneven(uniform - uneven if np.isfinite(uniform) else 0.0, phi)


def with_uneven_friction(scenario: Scenario, pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces with what uneven friction takes beyond its allowance, wherever little is to spare.

    It is looked for at a few of the narrowest places; the largest that is found is taken off at all of them.
    """
    distance, limit = AnatomyDistance.of(scenario), path_limits(scenario).clearance_m
    if distance is None or scenario.robot.n == 1 or not scenario.robot.friction.any():
        return list(pieces)

    def nearer(row: tuple[int, int]) -> float:
        piece, k = pieces[row[0]], row[1]
        return worst_uneven_friction(distance, piece.theta_b[k], piece.l_b[k]).nearer_m

    with ThreadPoolExecutor(cores()) as pool:
        result = pool.map(nearer, narrow_places(pieces, limit + NEAR_LIMIT_M))
        beyond = max([0.0, *(value - UNEVEN_FRICTION_M for value in result)])
    return [
        replace(piece, clearance_m=piece.clearance_m - np.where(_is_near(piece.clearance_m, limit), beyond, 0.0))
        for piece in pieces
    ]


def _is_near(clearance_m: Array, limit_m: float) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = clearance_m < limit_m + NEAR_LIMIT_M
    return near


def _uniform(pairs: int) -> Array:
    """(GRID^P, PARTS, P) states of a grid."""
    axes = np.meshgrid(*[np.linspace(-1, 1, GRID)] * pairs, indexing="ij")
    states: Array = np.repeat(np.stack(axes, axis=-1).reshape(-1, 1, pairs), PARTS, axis=1)
    return states


def _of_whole_pairs(pairs: int) -> Array:
    """(P, PARTS, P) changes of friction states that keep them uniform."""
    changes: Array = np.repeat(np.eye(pairs)[:, None], PARTS, axis=1)
    return changes


def _of_parts(pairs: int) -> Array:
    """(PARTS * P, PARTS, P) changes of one part of one pair."""
    return np.eye(PARTS * pairs).reshape(-1, PARTS, pairs)


def _nearest(clearances: Callable[[Array], Array], phi: Array, least_m: float, changes: Array) -> tuple[float, Array]:
    """Clearance [m] and state of a pattern search: single changes both ways, and the better ones together."""
    step = STEP

    def clearances_of(tried: Array) -> Array:
        """At the end of the range a change leads nowhere else."""
        result, is_other = np.full(len(tried), least_m), np.any(tried != phi, axis=(1, 2))
        if is_other.any():
            result[is_other] = clearances(tried[is_other])
        return result

    while step >= LEAST_STEP:
        tried = np.clip(phi + step * np.concatenate([changes, -changes]), -1, 1)
        result = clearances_of(tried)
        ways = result.reshape(2, -1)
        better = np.where(ways.min(axis=0) < least_m, np.where(ways[0] <= ways[1], 1.0, -1.0), 0.0)
        together = np.clip(phi + step * np.tensordot(better, changes, axes=1), -1, 1)
        result, tried = np.append(result, clearances_of(together[None])), np.concatenate([tried, together[None]])
        k = int(np.argmin(result))
        if result[k] < least_m - WORTH_M:
            least_m, phi = float(result[k]), tried[k]
        else:
            step /= 2
    return least_m, phi


def _clearances(distance: AnatomyDistance, at: FrictionStates, states: Array) -> Array:
    """(S,) [m] least clearance of bodies at a configuration; inf where no equilibrium was found."""
    result = at.bodies(states, spacing_m=POINT_SPACING_M)
    clearances = np.full(len(states), np.inf)
    if result.solved.any():
        bodies, count = result.point_m[result.solved], int(result.solved.sum())
        owner = np.repeat(np.arange(count), bodies.shape[1])
        clearances[result.solved] = distance.least(bodies.reshape(-1, 3), np.tile(result.radius_m, count), owner, count)
    return clearances
