"""Bodies in every corner of friction at one configuration, and how near to the anatomy uncertainty may displace them:
what searches allow for, and what chances of touching it are drawn from.

The core differentiates tips, not bodies. Bodies are differenced: solved at the middle of the intervals and at one end
of each axis of the box. The other end is taken to lie opposite; the worst combination is solved by whoever asks.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, alike
from ctrplan.base.long_work import cores
from ctrplan.mechanics.shapes import FrictionBodies
from ctrplan.scenario.scenario import anatomy_grid
from ctrplan.uncertainty.parameters import UncertainParameters, uncertain_parameters
from ctrplan.uncertainty.tip_slopes import (
    clamped_collars,
    friction_states,
)
from ctrplan.uncertainty.worst_case import (
    BaseBall,
    Farthest,
    IntervalSides,
    OffsetBox,
    farthest,
    reach_m,
    rough_reach_m,
)

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Registration, Scenario


@dataclass(frozen=True, eq=False)
class BodySpread:
    """One configuration in S friction states, N points from the plate to the tip."""

    point_m: Array  # (S, N, 3) robot frame
    radius_m: Array  # (N,)
    middle_m: Array  # (S, N, 3) displacement at the middle of the intervals
    sides_m: Array  # (S, N, 3, A) further displacement at the end of each axis of the box

    def sides(self) -> IntervalSides:
        """Displacements of all S N points, one state after the other."""
        states, count, _, axes = self.sides_m.shape
        return IntervalSides(self.middle_m.reshape(-1, 3), self.sides_m.reshape(states * count, 3, axes))


def body_spread(parameters: UncertainParameters, theta: Array, l: Array) -> BodySpread:  # noqa: E741
    """At commanded collars theta (n,) [rad], l (n,) [m]. NaN where there is no equilibrium."""
    box = OffsetBox.of(parameters)
    here = solved_bodies(parameters, np.zeros(parameters.count), theta, l)
    middle = solved_bodies(parameters, box.middle, theta, l) if box.middle.any() else here
    ends = [solved_bodies(parameters, box.middle + axis, theta, l) for axis in box.axes.T]
    pattern = here.point_m
    inner = alike(middle.point_m, pattern[0])
    displaced = [alike(end.point_m, pattern[0]) - inner for end in ends]
    sides = np.stack(displaced, axis=3) if ends else np.zeros((*pattern.shape, 0))
    return BodySpread(pattern, here.radius_m, inner - pattern, sides)


def solved_bodies(parameters: UncertainParameters, offset: Array, theta: Array, l: Array) -> FrictionBodies:  # noqa: E741
    """Bodies [m] in S friction states with parameters (P,) away from their values; NaN where a solve failed."""
    robot = parameters.robot_at(offset)
    theta_b, l_b = clamped_collars(parameters, robot, theta[None], l[None])
    result = robot.mechanics.friction_bodies(theta_b[0], l_b[0], friction_states(robot))
    lost = ~result.solved
    return replace(result, point_m=np.where(lost[:, None, None], np.nan, result.point_m))


def body_at(parameters: UncertainParameters, offset: Array, theta: Array, l: Array) -> tuple[Array, Array]:  # noqa: E741
    """(S, N, 3) of these bodies [m], and outer radii (N,) [m]."""
    result = solved_bodies(parameters, offset, theta, l)
    return result.point_m, result.radius_m


NEAR_M = 1e-3  # beside what may be narrowest: friction states between the corners are not looked at here
GRADIENT_STEP_M = 0.5e-3  # of the distance to the anatomy, differenced


@dataclass(frozen=True, eq=False)
class BodyClearance:
    """B = S N points of the bodies in S friction states, one state after the other; frames are the robot's."""

    scenario: Scenario
    parameters: UncertainParameters
    theta: Array  # (n,) commanded
    l: Array  # (n,)  # noqa: E741 (as in the equations)
    spread: BodySpread
    clearance_m: Array  # (B,) beyond the margins, outer radius taken off, by the anatomy's grid

    @classmethod
    def of(cls, scenario: Scenario, parameters: UncertainParameters, joints: Array) -> BodyClearance:
        """At joints (m,). Without an anatomy clearances are infinite."""
        theta, l = scenario.robot.drive.commanded(joints)  # noqa: E741 (as in the equations)
        spread = body_spread(parameters, theta, l)
        points = spread.point_m.reshape(-1, 3)
        radius = np.tile(spread.radius_m, len(spread.point_m))
        return cls(scenario, parameters, theta, l, spread, _distance(scenario, points) - radius)

    @property
    def point_m(self) -> Array:
        """(B, 3)."""
        return self.spread.point_m.reshape(-1, 3)

    @cached_property
    def sides(self) -> IntervalSides:
        """Displacements of all points."""
        return self.spread.sides()

    @cached_property
    def base(self) -> BaseBall:
        """The scenario's registration."""
        registration = self.scenario.registration
        return BaseBall.of(registration.position_sigma_m, registration.rotation_sigma_rad)

    @property
    def is_lost(self) -> bool:
        """Whether some body has no equilibrium within the intervals."""
        return bool(np.isnan(self.spread.sides_m).any() or np.isnan(self.spread.middle_m).any())

    @cached_property
    def reach_m(self) -> Array:
        """(B,) how far each point may be displaced, to first order; no less where that can't matter."""
        result = rough_reach_m(self.sides, self.base, self.point_m)
        rows = self.clearance_m - result - NEAR_M <= self.least_m
        moved = IntervalSides(self.sides.middle[rows], self.sides.sides[rows])
        result[rows] = reach_m(moved, self.base, self.point_m[rows])
        return result

    @property
    def least_m(self) -> float:
        """The smallest clearance without errors."""
        return float(self.clearance_m.min(initial=np.inf))

    @cached_property
    def near(self) -> NDArray[np.int_]:
        """Points that may come to be the narrowest."""
        return np.flatnonzero(self.clearance_m - self.reach_m - NEAR_M <= self.least_m)

    @cached_property
    def most_displaced(self) -> int:
        """The number of the point near the anatomy that may move farthest."""
        return int(self.near[np.argmax(self.reach_m[self.near])])

    @cached_property
    def worst(self) -> Farthest:
        """How that point is displaced farthest."""
        row = [self.most_displaced]
        moved = IntervalSides(self.sides.middle[row], self.sides.sides[row])
        return farthest(np.zeros((1, 3)), moved, self.base, self.point_m[row])

    @property
    def worst_offset(self) -> Array:
        """(P,) of the parameters there."""
        box = OffsetBox.of(self.parameters)
        result: Array = box.middle + box.axes @ self.worst.signs[0]
        return result

    @cached_property
    def beyond_first_order_m(self) -> float:
        """Largest difference [m] of points near the anatomy from first order, solved at the worst combination."""
        if not self.parameters.count:
            return 0.0
        solved = alike(body_at(self.parameters, self.worst_offset, self.theta, self.l)[0], self.spread.point_m[0])
        linear = self.point_m + self.sides.middle + self.sides.sides @ self.worst.signs[0]
        apart = np.linalg.norm(solved.reshape(-1, 3) - linear, axis=1)[self.near]
        return float(np.nan_to_num(apart, nan=np.inf).max(initial=0.0))

    @property
    def allowance_m(self) -> float:
        """What errors may take off the clearance; inf where a body within the intervals has no equilibrium."""
        if self.is_lost:
            return np.inf
        if not len(self.clearance_m) or not np.isfinite(self.least_m):
            return 0.0
        return float(self.reach_m[self.near].max()) + self.beyond_first_order_m

    def clearance_at(self, points_m: Array, rows: NDArray[np.int_]) -> Array:
        """(R,) of some of the points, were they elsewhere, (R, 3)."""
        result: Array = _distance(self.scenario, points_m) - self._radius_m[rows]
        return result

    @property
    def _radius_m(self) -> Array:
        return np.tile(self.spread.radius_m, len(self.spread.point_m))

    def normals(self, rows: NDArray[np.int_]) -> Array:
        """(R, 3) gradients of the clearance at some points, robot frame."""
        shifts = GRADIENT_STEP_M * np.eye(3)
        ends = [[_distance(self.scenario, self.point_m[rows] + side * shift) for side in (1, -1)] for shift in shifts]
        result: Array = np.array([(up - down) / (2 * GRADIENT_STEP_M) for up, down in ends]).T
        return result

    def slopes(self, rows: NDArray[np.int_]) -> Array:
        """(R, 3, P) of some points by the parameters."""
        by: Array = self.sides.sides[rows] @ np.linalg.pinv(OffsetBox.of(self.parameters).axes)
        return by


def _distance(scenario: Scenario, points_m: Array) -> Array:
    """(B,) [m] of points in the robot's frame beyond the anatomy's margins."""
    grid = anatomy_grid(scenario)
    if grid is None:
        return np.full(len(points_m), np.inf)
    return grid.sample(scenario.located(points_m))


ROWS, LOOKS = 12, 200  # samples of a path where bodies are solved at the ends of every interval, without errors
_USUAL: WeakKeyDictionary[Robot, dict[Registration, float]] = WeakKeyDictionary()


def is_uncertain(scenario: Scenario) -> bool:
    """Whether parameters of the robot or its registration have intervals."""
    return bool(uncertain_parameters(scenario.robot).count) or not scenario.registration.is_exact


def usual_allowance_m(scenario: Scenario, sample: Callable[[], Array]) -> float:
    """What nearly every state loses of its clearance [m], for searches, whose paths are certified after.

    The lower quartile over configurations (R, m) that `sample` returns; asked for once for a robot and a registration.
    """
    parameters = uncertain_parameters(scenario.robot)
    if not scenario.anatomy or not is_uncertain(scenario):
        return 0.0
    known = _USUAL.setdefault(scenario.robot, {})
    if scenario.registration not in known:
        results = [body.allowance_m for body in bodies_at(scenario, parameters, sample())]
        known[scenario.registration] = float(np.quantile(results, 0.25, method="lower"))
    return known[scenario.registration]


def bodies_at(scenario: Scenario, parameters: UncertainParameters, joints: Array) -> list[BodyClearance]:
    """At joints (R, m), on every core."""

    def look(q: Array) -> BodyClearance:
        body_clearance = BodyClearance.of(scenario, parameters, q)
        _ = body_clearance.allowance_m  # solved here, on this thread
        return body_clearance

    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(look, joints))


def narrow_rows(scenario: Scenario, parameters: UncertainParameters, joints: Array) -> NDArray[np.intp]:
    """Samples of a path, joints (K, m), where uncertainty may leave least room: what is drawn is looked at there.

    Bodies are solved at the ends of intervals at ROWS samples spread evenly, and without errors at up to LOOKS. How far
    points may be displaced is taken from the nearest of the former; the ROWS narrowest of the latter come on top.
    """
    even = _spread_evenly(len(joints), ROWS)
    known = bodies_at(scenario, parameters, joints[even])
    looks, rooms = _spread_evenly(len(joints), LOOKS), list[float]()
    with ThreadPoolExecutor(cores()) as pool:
        nearest = [known[int(np.argmin(np.abs(even - row)))] for row in looks]
        rooms = list(pool.map(partial(_room_beside, scenario, parameters), joints[looks], nearest))
    chosen = list[int]()
    for k in np.argsort(rooms, kind="stable").tolist():
        if len(chosen) < ROWS and all(abs(looks[k] - other) * LOOKS >= 2 * len(joints) for other in chosen):
            chosen.append(int(looks[k]))
    return np.unique([*even.tolist(), *chosen])


def _spread_evenly(count: int, most: int) -> NDArray[np.int_]:
    """Samples of `count`, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _room_beside(scenario: Scenario, parameters: UncertainParameters, q: Array, beside: BodyClearance) -> float:
    """[m] what displacements like those of a configuration nearby may leave at joints (m,); inf without a solution."""
    bodies, radius = body_at(
        parameters, np.zeros(parameters.count), *(part[0] for part in scenario.robot.drive.commanded(q[None]))
    )
    room = _distance(scenario, bodies.reshape(-1, 3)).reshape(len(bodies), -1) - radius
    reach = beside.reach_m.reshape(len(bodies), -1)
    at, own = np.linspace(0, 1, room.shape[1]), np.linspace(0, 1, reach.shape[1])
    left = room - np.array([np.interp(at, own, row) for row in reach])
    return float(np.nan_to_num(left, nan=np.inf).min(initial=np.inf))
