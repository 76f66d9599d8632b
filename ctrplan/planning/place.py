"""`ctrplan.place`: where the robot could stand so that it reaches a scenario's targets, ranked."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import EVENT, PROGRESS, SEED, Made, Number, Whole, checked, require
from ctrplan.base.arrays import LONGEST_MM, numbers
from ctrplan.base.long_work import StageProgress, interrupt_event
from ctrplan.base.package import shown
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.planning.base_pose import BaseFrame, BasePose, Patch, base_pose, middle_of, placed
from ctrplan.planning.base_screen import PoseScore, Screen
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.tip_solver import TipSolver

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.scenario.scenario import Scenario

RADIUS_M, CONE_RAD = 10e-3, math.radians(30.0)
CANDIDATES, CONFIRMED = 256, 8
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
    goal of joints, NoAnswerError where no pose of the patch leaves room for the robot.
    """
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
