"""Where uncertain parameters and registration bring a path nearest to the anatomy, and how likely it is to touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.planning.uncertainty.allowance import bodies_at, looked_at
from ctrplan.planning.uncertainty.body_clearance import BodyClearance
from ctrplan.planning.uncertainty.chance import SOLVED, Chance, Draws, chance
from ctrplan.planning.uncertainty.contributors import SECOND_ORDER, UNEXPLAINED, Contributor, ranked, sentence, shares
from ctrplan.uncertain.body_spread import alike, body_at
from ctrplan.uncertain.parameters import UncertainParameters

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

MOST_POINTS = 60  # of a sample, those that may come nearest
CHUNK = 1000  # draws at once


@dataclass(frozen=True, eq=False)
class ClosestApproach:
    """At the sample with the least room, of those that were looked at. Clearances are beyond the margins."""

    sample: int  # of the path
    joints: Array  # (m,)
    point_m: Array  # (3,) of the body without errors, anatomy frame
    nominal_m: float  # clearance of frictionless and corner shapes without errors
    worst_m: float  # less what parameters, registration and what calibration left unexplained may take off
    contributors: tuple[Contributor, ...]  # of the difference; shares add up to it
    beyond_first_order_m: float
    chance_margin: (
        Chance  # of coming nearer to the anatomy than its margin, anywhere on the path, in any friction state
    )
    chance_touch: Chance  # of touching it
    sentence: str


def closest_approach(scenario: Scenario, parameters: UncertainParameters, joints: Array) -> ClosestApproach | None:
    """On a path, joints (K, m); None in free space."""
    if not scenario.anatomy:
        return None
    rows = looked_at(len(joints))
    bodies = bodies_at(scenario, parameters, joints[rows])
    room = [body.least_m - body.allowance_m for body in bodies]
    narrowest = int(np.argmin(room))
    body, unexplained = bodies[narrowest], scenario.robot.model_error_m
    contributors = _contributors(body, unexplained)
    touched = -min(part.margin_m for part in scenario.anatomy)
    clearance = _drawn(scenario, parameters, bodies, narrowest)
    point = body.point_m[body.most_displaced]
    return ClosestApproach(
        sample=int(rows[narrowest]),
        joints=joints[rows[narrowest]],
        point_m=scenario.base_R @ point + scenario.base_position_m,
        nominal_m=body.least_m,
        worst_m=room[narrowest] - unexplained,
        contributors=contributors,
        beyond_first_order_m=body.beyond_first_order_m,
        chance_margin=_chance(clearance, 0.0),
        chance_touch=_chance(clearance, touched),
        sentence=sentence(body.allowance_m + unexplained, contributors),
    )


def _contributors(body: BodyClearance, unexplained_m: float) -> tuple[Contributor, ...]:
    row, u = body.most_displaced, body.worst.direction[0]
    by = body.slopes(np.array([row]))[0]
    given = shares(body.parameters, u, by, body.worst_offset, body.base, body.point_m[row], unexplained_m)
    given[SECOND_ORDER] = body.allowance_m + unexplained_m - sum(given.values())  # and the gaps between directions
    saved = {name: share for name, share in given.items() if name != SECOND_ORDER}
    return ranked(given, saved | {UNEXPLAINED: unexplained_m})


Clearances = tuple[Array, Array, Array]  # (M,) over the path, (R,) at the narrowest sample: linearised, solved


def _chance(found: Clearances, level_m: float) -> Chance:
    """Of falling below a level on the path; what solves change at the narrowest sample is carried over."""
    path, linear, solved = found
    first = path[: len(solved)]
    corrected = np.where(linear <= first, solved, np.minimum(first, solved))
    return chance(path < level_m, ~(corrected >= level_m))


def _drawn(
    scenario: Scenario, parameters: UncertainParameters, bodies: list[BodyClearance], narrowest: int
) -> Clearances:
    draws = Draws.of(parameters, scenario.registration, scenario.robot.model_error_m)
    each = [_linear(body, draws) for body in bodies]
    body = bodies[narrowest]
    solved = np.array([_solved(body, draws, k) for k in range(min(SOLVED, len(draws.offset)))])
    path: Array = np.min([found for found in each], axis=0)
    return path, each[narrowest][: len(solved)], solved


def _points(body: BodyClearance) -> NDArray[np.int_]:
    room = body.clearance_m - body.reach_m
    return np.argsort(room, kind="stable")[:MOST_POINTS]


def _linear(body: BodyClearance, draws: Draws) -> Array:
    """(M,) smallest clearance of the linearised bodies before the linearised anatomy."""
    rows = _points(body)
    normal, point = body.normals(rows), body.point_m[rows]
    by = np.einsum("rc,rcp->rp", normal, body.slopes(rows))
    turned = np.cross(point, normal)  # n . (w x p) = w . (p x n)
    found = np.empty(len(draws.offset))
    for first in range(0, len(found), CHUNK):
        part = slice(first, first + CHUNK)
        moved = draws.offset[part] @ by.T + draws.turn_rad[part] @ turned.T
        moved += (draws.shift_m[part] + draws.unexplained_m[part]) @ normal.T
        found[part] = (body.clearance_m[rows] + moved).min(axis=1)
    return found


def _solved(body: BodyClearance, draws: Draws, k: int) -> float:
    """The smallest clearance of draw k, its robot solved and placed before the anatomy; NaN without a solution."""
    solved = alike(body_at(body.parameters, draws.offset[k], body.theta, body.l)[0], body.spread.point_m)
    points = solved.reshape(-1, 3)[_points(body)]
    placed = points + draws.shift_m[k] + np.cross(draws.turn_rad[k], points) + draws.unexplained_m[k]
    return float(body.clearance_at(placed, _points(body)).min())
