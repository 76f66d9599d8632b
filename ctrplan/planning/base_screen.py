"""A cheap evaluation of base poses: zero-clearance shapes to each target, their room in the anatomy, bounds of the
best.

What the tip can reach belongs to the robot: it is drawn once, and each pose asks for what lies near its targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ctrplan.anatomy.anatomy_field import anatomy_field, shared_spacing_m
from ctrplan.anatomy.clearance_grid import SignedDistanceField, field_bounds
from ctrplan.anatomy.parts import exact_clearance
from ctrplan.base.arrays import Array
from ctrplan.mechanics.walk import Field
from ctrplan.motion.checker import DEFINITE_COLLISION_M, breach, search_limits
from ctrplan.planning.base_pose import BaseFrame, Patch
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.tip_solver import TipSolver, TipTarget, angle_to


def patch_field(scenario: Scenario, patch: Patch) -> SignedDistanceField | None:
    """None in free space. Bricks that are on disk for other poses of the robot are taken from there."""
    if not scenario.anatomy:
        return None
    reach = max(tube.length_m for tube in scenario.robot.tubes) + scenario.robot.tubes[0].outer_diameter_m
    ends = [patch.center_m, *([] if patch.along_m is None else [patch.along_m])]
    middle = np.mean(ends, axis=0)
    far = reach + patch.radius_m + max(float(np.linalg.norm(end - middle)) for end in ends)
    lower, upper = _around(scenario, middle, far)
    return anatomy_field(
        scenario.anatomy,
        lower,
        upper,
        shared_spacing_m(scenario.anatomy, reach),
        base_position_m=middle,
        reach_m=far,
    )


def _around(scenario: Scenario, middle_m: Array, far_m: float) -> tuple[Array, Array]:
    """Corners (3,), (3,) of what lies in front of a base in the middle or behind it."""
    halves = [field_bounds(scenario.anatomy, far_m, middle_m, np.diag([1.0, side, side])) for side in (1.0, -1.0)]
    return np.min([lower for lower, _ in halves], axis=0), np.max([upper for _, upper in halves], axis=0)


def grid_from(grid: SignedDistanceField, pose: BaseFrame) -> Field:
    """The grid as the core takes it for a robot at a pose."""
    return Field(grid.values_m, grid.origin_m, float(grid.spacing_m), pose.R, pose.position_m)


SAMPLES = 20_000  # configurations of the robot
NEAR = 32  # of them, the nearest to a target, whose room is looked at
SOLVED = 6  # of those, the ones with most room, which are led to the target
NEAR_M = 15e-3  # a target with no sample within this is out of reach
STEPS = 8  # of each that is led to its target
GAP_M = 1e-3  # about what clearance moves a tip
TURN_RAD = 0.2  # likewise of its tangent, with friction


@dataclass(frozen=True, eq=False)
class PoseScore:
    """What a pose seems to be worth."""

    pose: BaseFrame
    likely: int  # targets reached with room for the friction error
    reached: int  # targets reached within their tolerance, without definite collision
    possible: int  # targets reached without definite collision, or nearly
    share: float  # worst bound of those, in tolerances of their targets
    room_m: float  # least of those, beyond the bound

    @property
    def rank(self) -> tuple[float, ...]:
        """Less is better: where friction's error has no room, the pose comes first that lacks least of it."""
        return (-self.likely, -self.reached, -self.possible, max(0.0, -self.room_m), self.share, -self.room_m)


@dataclass(frozen=True, eq=False)
class _Attempts:
    """Configurations that are to reach a target from a pose."""

    pose: NDArray[np.int_]  # (K,) numbers of poses and
    target: NDArray[np.int_]  # (K,) of targets
    goal: Array  # (K, 3) robot's frame
    q: Array  # (K, m)


class Screen:
    """One robot and one anatomy, many poses."""

    def __init__(self, scenario: Scenario, patch: Patch, rng: np.random.Generator) -> None:
        """Draws the robot's configurations."""
        self.scenario, self.patch, self.targets = scenario, patch, scenario.targets
        self.wanted_m = np.array([goal.tip_m for goal in self.targets])
        self.tolerance_m = np.array([goal.tolerance_m for goal in self.targets])
        self.solver = TipSolver(JointSpace.of(scenario), scenario.robot.mechanics)
        self.limits = search_limits(scenario, 0.0)
        q = self.solver.space.sample(rng, SAMPLES)
        tip, _ = self.solver.tips(q)
        solved = ~np.isnan(tip).any(axis=1)
        self.q = q[solved]
        self.tips = cKDTree(self._reduced(tip[solved]))

    @cached_property
    def grid(self) -> SignedDistanceField | None:
        """The anatomy as all poses see it; built when the first of them could reach a target."""
        return patch_field(self.scenario, self.patch)

    def is_clear(self, pose: BaseFrame) -> bool:
        """Whether tubes can leave the plate there, some target is within reach, and the start is valid."""
        robot = self.scenario.robot
        if exact_clearance(self.scenario.anatomy, pose.position_m[None])[0] < robot.tubes[-1].outer_diameter_m / 2:
            return False
        away, _ = self.tips.query(self._reduced(pose.into_robot(self.wanted_m)))
        return bool(np.any(away < NEAR_M)) and self._may_start(pose)

    def _may_start(self, pose: BaseFrame) -> bool:
        """Whether the start keeps all limits there, in every corner."""
        start = self.scenario.start[None]
        if self._rooms(pose, start)[0] < DEFINITE_COLLISION_M:
            return False
        if self.grid is None:
            return True
        collars = self.solver.space.drive.collars(start)
        samples = self.solver.mechanics.check_path(*collars, grid_from(self.grid, pose), limits=self.limits)
        return not breach(samples, self.limits)

    def look(self, poses: Sequence[BaseFrame]) -> list[PoseScore]:
        """What several poses, at least one, seem to be worth."""
        tried = self._attempts(poses)
        result = self.solver.solve(TipTarget(tried.goal), tried.q, STEPS, turned=False)
        room = self._rooms_of(poses, tried.pose, result.joints)
        usable = result.error_m <= self.tolerance_m[tried.target] + GAP_M
        usable &= (room > DEFINITE_COLLISION_M) & self._looks_right(poses, tried, result.tangent)
        bound = self._bounds(result.joints, np.flatnonzero(usable))
        reaches = result.error_m <= self.tolerance_m[tried.target]
        return [
            self._worth(pose, tried.target[rows], bound[rows], room[rows], reaches[rows])
            for pose, rows in _each(poses, tried)
        ]

    def _attempts(self, poses: Sequence[BaseFrame]) -> _Attempts:
        """For every pose and target the samples near it that have most room."""
        goal = np.concatenate([pose.into_robot(self.wanted_m) for pose in poses])
        _, near = self.tips.query(self._reduced(goal), k=min(NEAR, len(self.q)))
        near = near.reshape(len(goal), -1)
        each = near.shape[1]
        goals = np.repeat(goal, each, axis=0)
        q = self.solver.turned_towards(TipTarget(goals), self.q[near.ravel()])
        pose = np.repeat(np.arange(len(poses)), len(self.targets) * each)
        room = self._rooms_of(poses, pose, q).reshape(len(goal), each)
        best = np.argsort(-room, axis=1, kind="stable")[:, :SOLVED]
        rows = (each * np.arange(len(goal))[:, None] + best).ravel()
        target = np.tile(np.repeat(np.arange(len(self.targets)), each), len(poses))
        return _Attempts(pose[rows], target[rows], goals[rows], q[rows])

    def _rooms_of(self, poses: Sequence[BaseFrame], pose: NDArray[np.int_], q: Array) -> Array:
        """(K,) [m] as `_rooms`, each row from its own pose; rows of one pose follow each other."""
        return np.concatenate([self._rooms(each, q[pose == k]) for k, each in enumerate(poses)])

    def _rooms(self, pose: BaseFrame, q: Array) -> Array:
        """(K,) [m] that zero-clearance shapes leave beyond margins and the model's error."""
        if self.grid is None:
            return np.full(len(q), np.inf)
        field = grid_from(self.grid, pose)
        result = self.solver.mechanics.zero_clearance_rooms(*self.solver.space.drive.collars(q), field)[0]
        return np.asarray(result - self.limits.clearance_m)

    def _looks_right(self, poses: Sequence[BaseFrame], tried: _Attempts, tangent: Array) -> NDArray[np.bool_]:
        """(K,) whether tips point about where their targets ask them to."""
        right = np.ones(len(tangent), dtype=bool)
        for k, goal in enumerate(self.targets):
            if goal.direction is not None and goal.direction_tolerance_rad is not None:
                rows = tried.target == k
                turns = np.array([pose.R for pose in poses])[tried.pose[rows]]
                there = np.einsum("kij,kj->ki", turns, tangent[rows])
                right[rows] = angle_to(there, goal.direction) <= goal.direction_tolerance_rad + TURN_RAD
        return right

    def _bounds(self, q: Array, rows: NDArray[np.int_]) -> Array:
        """(K,) [m] of some rows of q (K, m), inf elsewhere and where a limit is broken."""
        bound = np.full(len(q), np.inf)
        if len(rows):
            solved = self.solver.mechanics.bound_many(*self.solver.space.drive.collars(q[rows]))
            sound = (solved.stability >= self.limits.stability) & (solved.max_strain <= self.limits.max_strain)
            bound[rows] = np.where(sound, solved.position_m, np.inf)
        return bound

    def _worth(
        self, pose: BaseFrame, target: NDArray[np.int_], bound: Array, room: Array, reaches: NDArray[np.bool_]
    ) -> PoseScore:
        likely, reached, shares, rooms = 0, 0, [0.0], [np.inf]
        for k, tolerance in enumerate(self.tolerance_m):
            rows = np.flatnonzero((target == k) & np.isfinite(bound))
            if len(rows):
                lacks = np.maximum(bound[rows] - room[rows], 0.0)
                best = rows[
                    np.lexsort((bound[rows], lacks, ~reaches[rows]))[0]
                ]  # what reaches and fits, then least bound
                reached += bool(reaches[best])
                likely += bool(reaches[best] and room[best] >= bound[best])
                shares.append(bound[best] / tolerance)
                rooms.append(room[best] - bound[best])
        return PoseScore(pose, likely, reached, len(rooms) - 1, max(shares), min(rooms))

    def _reduced(self, points: Array) -> Array:
        """Points (K, 3) of the robot's frame without what turning all tubes together changes."""
        if self.solver.common_rotation is None:
            return points
        return np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])


def _each(poses: Sequence[BaseFrame], tried: _Attempts) -> list[tuple[BaseFrame, NDArray[np.int_]]]:
    """Every pose with its rows."""
    return [(pose, np.flatnonzero(tried.pose == k)) for k, pose in enumerate(poses)]
