"""`ctrplan.place`: where the robot could stand so that it reaches a scenario's targets, ranked.

A cheap evaluation of base poses: zero-clearance shapes to each target, their room in the anatomy, bounds of the
best.

What the tip can reach belongs to the robot: it is drawn once, and each pose asks for what lies near its targets.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ctrplan.anatomy.clearance_grid import SignedDistanceField, anatomy_field, field_bounds, shared_spacing_m
from ctrplan.anatomy.parts import exact_clearance
from ctrplan.base.arguments import CANDIDATES, CONFIRMED, EVENT, PROGRESS, SEED, Made, Number, Whole, checked, require
from ctrplan.base.arrays import LONGEST_MM, Array, numbers
from ctrplan.base.long_work import StageProgress, interrupt_event
from ctrplan.base.package import shown
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.mechanics.walk import Field
from ctrplan.motion.checker import DEFINITE_COLLISION_M
from ctrplan.motion.limits import breach, search_limits
from ctrplan.planning.base_pose import BaseFrame, BasePose, Patch, base_pose, middle_of, placed
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.sizes import refuse_loads
from ctrplan.scenario.tip_solver import TipSolver, TipTarget, angle_to

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.scenario.scenario import Scenario


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
OUT_OF_REACH_M = 15e-3  # a target with no sample within this is out of reach
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
        return bool(np.any(away < OUT_OF_REACH_M)) and self._may_start(pose)

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
        q, _, _ = self.solver.turned_towards(TipTarget(goals), self.q[near.ravel()])
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


RADIUS_M, CONE_RAD = 10e-3, math.radians(30.0)
DRAWN = 40  # poses for each candidate, after which a patch counts as blocked
AT_ONCE = 16  # poses that are looked at together
RADIUS, CONE = Number(0.0, 1.0, "m"), Number(0.0, math.pi / 2, "rad")
MANY, FEW = Whole(1, 100_000), Whole(1, 1000)
FARTHEST = Number(-LONGEST_MM * 1e-3, LONGEST_MM * 1e-3, "m")


@shown
@dataclass(frozen=True, eq=False)
class Placement:
    """Base poses for a scenario, best first."""

    poses: tuple[BasePose, ...]  # with bounds in all corners
    own: BasePose  # the scenario's own pose, which is one of `poses` where the patch is around it
    drawn: int  # poses that were tried
    clear: int  # of them those where the start is valid and a target is within reach
    promising: int  # of them those where a zero-clearance shape reaches a target without definite collision
    interrupted: bool = False

    @property
    def sentence(self) -> str:
        """What was tried, and what came of it."""
        tried = (
            f"{self.drawn} poses tried: {self.clear} have a valid start and a target within reach, "
            f"{self.promising} seem to reach one, the best {len(self.poses)} were confirmed"
        )
        if self.interrupted:
            tried += " before the interruption"
        best, count = self.poses[0], len(self.own.targets)
        if not best.reached:
            return f"{tried}; none reaches a target within all limits and margins: {best.reason}."
        return f"{tried}; the best reaches {best.reached} of {count} targets, the scenario's own {self.own.reached}."


@checked(
    scenario=Made("Scenario"),
    radius_m=RADIUS,
    cone_rad=CONE,
    candidates=MANY,
    confirmed=FEW,
    plans=Whole(0, 1000),
    seed=SEED,
    progress=PROGRESS,
    interrupted=EVENT,
)
def place(
    scenario: Scenario,
    *,
    center_m: ArrayLike | None = None,
    along_m: ArrayLike | None = None,
    aim_m: ArrayLike | None = None,
    radius_m: float = RADIUS_M,
    cone_rad: float = CONE_RAD,
    candidates: int = CANDIDATES,
    confirmed: int = CONFIRMED,
    plans: int = 0,
    seed: int = 0,
    progress: StageProgress | None = None,
    interrupted: threading.Event | None = None,
) -> Placement:
    """Base poses from which a scenario's tip targets are reached, best first.

    Positions lie on a disc of `radius_m` [m] around `center_m` (3,) [m], anatomy's frame, by default the scenario's own
    base; with `along_m` (3,) [m] along the opening between both. Directions lie in a cone of half angle `cone_rad`
    about the way to `aim_m` (3,) [m], by default the targets' middle; the disc stands across that way. `candidates` of
    them with a valid start are looked at cheaply, the best `confirmed` by inverse kinematics with bounds of all
    corners, the best `plans` of those by a plan each. Ranked by valid start, plan, targets reached, the worst error
    beside its tolerance, clearance.

    The same for the same seed. Ctrl-C, or setting `interrupted`, keeps what was found so far. Raises InputError for a
    goal of joints and for a robot with loads, NoAnswerError where no pose of the patch leaves room for the robot.
    """
    refuse_loads(scenario.robot, scenario.robot.path, "effects")
    for goal in scenario.targets:
        if goal.tip_m is None or goal.joints is not None:  # joints would lead elsewhere from another pose
            raise InputError("says nothing of a place: a tip is needed", file=scenario.path, key=goal.place)
    report, has_patch = progress or (lambda _stage, _share: None), center_m is not None
    patch = _patch(scenario, center_m, along_m, aim_m, float(radius_m), float(cone_rad))
    with interrupt_event(interrupted) as stop:
        own = base_pose(scenario, seed, is_own=True)
        search = _Search(scenario, patch, seed, report, stop)
        worths = search.promising(int(candidates))
        result = search.confirmed(worths[: confirmed - (not has_patch)])
        poses = sorted([*result, *([] if has_patch else [own])], key=lambda pose: pose.rank)
        poses[:plans] = search.planned(poses[:plans])
        if not poses:
            raise _nothing(scenario, search, stop)
        ranked = tuple(sorted(poses, key=lambda pose: pose.rank))
        own = next((pose for pose in ranked if pose.is_own), own)
        return Placement(ranked, own, search.drawn, search.clear, len(worths), stop.is_set())


def _patch(
    scenario: Scenario,
    center_m: ArrayLike | None,
    along_m: ArrayLike | None,
    aim_m: ArrayLike | None,
    radius_m: float,
    cone_rad: float,
) -> Patch:
    center = scenario.base_position_m if center_m is None else _point("center_m", center_m)
    along = None if along_m is None else _point("along_m", along_m)
    aim = middle_of(scenario.targets) if aim_m is None else _point("aim_m", aim_m)
    rolls = TipSolver(JointSpace.of(scenario), scenario.robot.mechanics).common_rotation is None
    return Patch(center, along, radius_m, cone_rad, aim, scenario.base_R, rolls)


def _point(key: str, value: ArrayLike) -> Array:
    """(3,) [m]. Raises InputError."""
    point = numbers(value, key)
    if point.shape != (3,):
        raise InputError("must be three numbers", key=key, value=value, unit="m")
    for coordinate in point.tolist():
        require(key, coordinate, FARTHEST)
    return point


class _Search:
    """Candidates, looked at more and more closely."""

    def __init__(
        self, scenario: Scenario, patch: Patch, seed: int, report: StageProgress, stop: threading.Event
    ) -> None:
        self.scenario, self.patch, self.seed, self.report, self.stop = scenario, patch, seed, report, stop
        self.drawn = self.clear = 0

    def promising(self, count: int) -> list[PoseScore]:
        """The candidates, of `count` tried, that seem to reach a target, best first."""
        screen = Screen(self.scenario, self.patch, np.random.default_rng(self.seed))
        results: list[PoseScore] = []
        poses = self._clear_poses(screen, count)
        while batch := list(islice(poses, AT_ONCE)):
            results += [worth for worth in screen.look(batch) if worth.possible]
            self.report("poses", min(1.0, self.clear / count))
        return sorted(results, key=lambda worth: worth.rank)

    def _clear_poses(self, screen: Screen, count: int) -> Iterator[BaseFrame]:
        for pose in islice(self.patch.poses(self.seed), DRAWN * count):
            if self.clear == count or self.stop.is_set():
                return
            self.drawn += 1
            if screen.is_clear(pose):
                self.clear += 1
                yield pose

    def confirmed(self, worths: Sequence[PoseScore]) -> list[BasePose]:
        """Inverse kinematics from each of the best."""
        results = []
        for k, worth in enumerate(worths):
            if self.stop.is_set():
                break
            self.report("confirming", k / len(worths))
            results.append(base_pose(placed(self.scenario, worth.pose), self.seed))
        return results

    def planned(self, poses: Sequence[BasePose]) -> list[BasePose]:
        """With a plan each, or the reason why there is none."""
        from ctrplan.planning.planner import plan  # slow to import, as OMPL is

        result = list(poses)
        for k, pose in enumerate(poses):
            if self.stop.is_set():
                break
            self.report("plans", k / len(poses))
            try:
                result[k] = replace(pose, plan=plan(pose.scenario, seed=self.seed, interrupted=self.stop))
            except NoAnswerError as error:
                result[k] = replace(pose, plan_reason=str(error).rstrip("."))
            except KeyboardInterrupt:  # before there was a path
                break
        return result


def _nothing(scenario: Scenario, search: _Search, stop: threading.Event) -> Exception:
    """Why there is no pose to speak of."""
    if stop.is_set():
        return KeyboardInterrupt()  # type: ignore[return-value]
    what = (
        "none of them seems to reach a target without collision"
        if search.clear
        else "at each the start is not valid or no target is within reach"
    )
    return NoAnswerError(f"{scenario.path or scenario.name}: {search.drawn} base poses were tried, {what}.")
