"""What uncertain parameters, registration and unexplained errors may do to a motion: at the goal, and nearest to the
anatomy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, alike
from ctrplan.base.package import shown
from ctrplan.uncertainty.body_clearance import BodyClearance, bodies_at, body_at, narrow_rows
from ctrplan.uncertainty.parameters import UncertainParameters
from ctrplan.uncertainty.worst_case import (
    DISTRIBUTION,
    DRAWS,
    SECOND_ORDER,
    SOLVED,
    UNEXPLAINED,
    Chance,
    Contributor,
    Draws,
    TurnContributor,
    chance,
    ranked,
    sentence,
    shares,
)

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class TurnMiss:
    """Angles of the tip's tangent from a target's direction; registration and play turn it too."""

    worst_rad: float  # every friction state, parameters anywhere in their box, base in its 95 % ball
    contributors: tuple[TurnContributor, ...]  # largest first; their shares add up to `worst_rad`
    friction_state: tuple[float, ...]  # phi of the worst case
    beyond_first_order_rad: float  # in `worst_rad`
    tolerance_rad: float
    chance_any_friction: Chance  # of being turned by more than the tolerance in the worst of all friction states
    chance_by_history: Chance | None  # and with friction as simulated from the plan's start
    quantile_any_friction_rad: float  # 95 % of robots are turned by less, in the worst friction state
    quantile_by_history_rad: float | None
    sentence: str


@shown
@dataclass(frozen=True, eq=False)
class GoalMiss:
    """Distances of the tip from a target's; for one in joint values, from where the frictionless tip shall be."""

    worst_m: float  # every friction state, parameters anywhere in their box, base and unexplained error in 95 % balls
    contributors: tuple[Contributor, ...]  # largest first; their shares add up to `worst_m`
    friction_state: tuple[float, ...]  # phi of the worst case
    beyond_first_order_m: float  # by how much the solved worst case differs from the linear one; in `worst_m`
    tolerance_m: float | None
    chance_any_friction: Chance | None  # of missing a tolerance, the direction's included, in the worst friction state
    chance_by_history: Chance | None  # and with friction as simulated from the plan's start
    quantile_any_friction_m: float  # 95 % of robots miss by less, in the worst friction state
    quantile_by_history_m: float | None
    sentence: str
    name: str = ""  # of the target
    sample: int | None = None  # of the path, where the worst case is: on the way along a line, else at its end
    turn: TurnMiss | None = None  # None without a direction


@dataclass(frozen=True)
class TourMiss:
    """Chances of missing at least one of several targets; those in joint values can't be missed."""

    targets: int  # that can be
    chance_any_friction: Chance  # in the worst friction state at each
    chance_by_history: Chance | None  # with friction as simulated through all of them


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
    rows = narrow_rows(scenario, parameters, joints)
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


def _chance(clearances: Clearances, level_m: float) -> Chance:
    """The chance of falling below a level on the path; what solves change at the narrowest sample is carried over."""
    path, linear, solved = clearances
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
    path: Array = np.min([row for row in each], axis=0)
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
    result = np.empty(len(draws.offset))
    for first in range(0, len(result), CHUNK):
        part = slice(first, first + CHUNK)
        moved = draws.offset[part] @ by.T + draws.turn_rad[part] @ turned.T
        moved += (draws.shift_m[part] + draws.unexplained_m[part]) @ normal.T
        result[part] = (body.clearance_m[rows] + moved).min(axis=1)
    return result


def _solved(body: BodyClearance, draws: Draws, k: int) -> float:
    """The smallest clearance of draw k, its robot solved and placed before the anatomy; NaN without a solution."""
    solved = alike(body_at(body.parameters, draws.offset[k], body.theta, body.l)[0], body.spread.point_m[0])
    points = solved.reshape(-1, 3)[_points(body)]
    placed = points + draws.shift_m[k] + np.cross(draws.turn_rad[k], points) + draws.unexplained_m[k]
    return float(body.clearance_at(placed, _points(body)).min())


@dataclass(frozen=True)
class ParameterInterval:
    """A number that is known by its 95 % interval, in the unit of its file."""

    name: str
    title: str  # for people
    value: float
    low: float
    high: float
    unit: str


@shown
@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Worst cases and chances at the targets, and where the motion comes nearest to the anatomy."""

    parameters: tuple[ParameterInterval, ...]
    position_sigma_m: float  # of the base, each coordinate
    rotation_sigma_rad: float  # of the base, about each axis
    model_error_m: float  # 95th percentile of what calibration left unexplained: one pose in twenty exceeds it
    goal: GoalMiss
    closest: ClosestApproach | None  # None in free space
    distribution: str = DISTRIBUTION
    draws: int = DRAWS  # of the linearised model
    solved: int = SOLVED  # of them
    via: tuple[GoalMiss, ...] = ()  # at the targets before the goal, of a plan
    tour: TourMiss | None = None  # at all targets together; None where fewer than two can be missed
    simulated: int = 0  # of the draws: robots whose histories were simulated; 0 without a plan

    def to_json(self) -> dict[str, Any]:
        """Plain tables, for plan.json."""
        return {entry.name: _plain(getattr(self, entry.name)) for entry in fields(self)}


def intervals(parameters: UncertainParameters) -> Iterator[ParameterInterval]:
    """The parameters one by one."""
    ends = zip(parameters.value, parameters.low, parameters.high, strict=True)
    for k, (value, low, high) in enumerate(ends):
        si, name = float(parameters.si[k]), parameters.names[k]
        unit, title = parameters.unit[k], parameters.title[k]
        yield ParameterInterval(name, title, float(value) / si, float(low) / si, float(high) / si, unit)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if hasattr(value, "__dataclass_fields__"):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    return value
