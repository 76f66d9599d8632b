"""All targets of a set at once: what a robot is worth for them; what `ctrplan design` does with each design."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta, Struct

from ctrplan.base.arguments import MOST_STARTS
from ctrplan.errors import NoAnswerError
from ctrplan.storage.toml_document import Point, Tolerance, metres
from ctrplan.studies.study.sources import ROBOT_PREFIX
from ctrplan.studies.study.task import Loaded, TaskKind, register

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Goal, Scenario
    from ctrplan.studies.study.task import Task
    from ctrplan.studies.target_set import RobotPair

TARGET_S = 0.4  # of one core


class SideEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """Overrides that make one number of the robot a little smaller and a little larger."""

    name: str
    low: list[str]
    high: list[str]
    is_tolerance: bool = False  # whether it can come out anywhere between them; else it is a step to either side


@register("target_set")
class TargetSetTask(TaskKind, frozen=True, kw_only=True):
    """kind = "target_set": share of the points reached, mean error at worst, least stability on the way to them."""

    needs: ClassVar[tuple[Literal["robot", "scenario"], ...]] = ("scenario",)
    best: ClassVar[str] = "error_mm"

    points_mm: Annotated[list[Point], Meta(min_length=1, max_length=10_000)]
    tolerance_mm: Tolerance = 1.0
    starts: Annotated[int, Meta(ge=1, le=MOST_STARTS)] = 40
    unreached_mm: Tolerance = 10.0
    sides: list[SideEntry] = []
    front: list[dict[str, float]] = []

    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        return TARGET_S * len(self.points_mm) * 2.0 ** (robot.n - 3) * (0.5 + self.starts / 80)

    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        from ctrplan.studies.target_set import Search, error_slopes_mm, robust_value, set_value  # slow to import

        scenario, goals = loaded.place, self._goals()
        search = Search(self.starts, task.settings["seed"], self.unreached_mm, tuple(self.front))
        worth = set_value(scenario, goals, search)
        if not worth.reached:
            raise NoAnswerError("no target is reached within limits and margins.")
        pairs = [_pair(side, scenario, task.overrides) for side in self.sides]
        slopes_mm = error_slopes_mm(scenario, goals, worth, pairs)
        results: dict[str, Any] = {
            "reach": worth.reach,
            "error_mm": worth.error_mm,
            "bound_mm": float(np.mean([target.bound_m * 1e3 for target in worth.reached])),
            "largest_mm": float(np.max(worth.errors_mm)),
            "within": float(np.mean(worth.errors_mm <= self.tolerance_mm)),
            "stability": worth.stability,
            "clearance_mm": worth.clearance_mm,
            "errors_mm": json.dumps([round(value, 6) for value in worth.errors_mm.tolist()]),
            "joints": json.dumps([target and scenario.robot.drive.named(target.joints) for target in worth.targets]),
        }
        results |= {f"slope.{pair.name}": value for pair, value in zip(pairs, slopes_mm.tolist(), strict=True)}
        rows = [k for k, side in enumerate(self.sides) if side.is_tolerance]
        if rows:
            robust = robust_value(scenario, goals, worth, slopes_mm[rows], [pairs[k] for k in rows], search)
            results |= {"robust_mm": robust.error_mm, "robust_reach": robust.reach}
            results["robust_first_order_mm"] = robust.first_order_mm
        return results

    def _goals(self) -> list[Goal]:
        from ctrplan.scenario.scenario import Goal

        return [
            Goal(joints=None, tip_m=metres(point), tolerance_m=self.tolerance_mm * 1e-3) for point in self.points_mm
        ]


def _pair(side: SideEntry, scenario: Scenario, overrides: Sequence[str]) -> RobotPair:
    from ctrplan.files.robot_file import load_robot
    from ctrplan.studies.target_set import RobotPair

    def robot(changed: Sequence[str]) -> Robot:
        all_of_them = [
            text.removeprefix(ROBOT_PREFIX) for text in (*overrides, *changed) if text.startswith(ROBOT_PREFIX)
        ]
        return load_robot(scenario.robot.path or "", all_of_them)

    return RobotPair(side.name, robot(side.low), robot(side.high))
