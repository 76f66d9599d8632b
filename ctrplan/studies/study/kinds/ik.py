"""Inverse kinematics of one point: reachable or not, and how well, whatever friction does."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from ctrplan.base.arguments import MOST_STARTS
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.storage.toml_document import Point, Tolerance, Vector
from ctrplan.studies.study.task import Loaded, TaskKind, register

if TYPE_CHECKING:
    from ctrplan.planning.inverse_kinematics import InverseKinematics
    from ctrplan.planning.reach import Configuration
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.studies.study.task import Task

SOLVE_S = 0.8  # of one core, on a three-tube robot with the default starts


@register("ik")
class InverseKinematicsTask(TaskKind, frozen=True, kw_only=True):
    """kind = "ik": configurations for the target; the least bound of those that keep limits and margins."""

    uses_target: ClassVar[bool] = True
    best: ClassVar[str] = "worst_mm"

    tip_mm: Point | None = None  # where the study has no [targets] and no scenario's goal
    tolerance_mm: Tolerance | None = None  # by default the target's or the scenario's goal's, else 1 mm
    direction: Vector | None = None
    direction_tolerance_deg: Annotated[float, Meta(gt=0, le=180)] | None = None
    starts: Annotated[int, Meta(ge=1, le=MOST_STARTS)] = 100

    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        return SOLVE_S * 2.0 ** (robot.n - 3) * (0.5 + self.starts / 200)

    def check(self, task: Task, loaded: Loaded) -> None:
        count, is_said = len(loaded.place.targets), "tip_mm" in task.settings or self.tip_mm is not None
        if count > 1 and loaded.target is None and not is_said:
            rule = f"is missing: the scenario has {count} targets, say one here or all in [targets]"
            raise InputError(rule, key="task.tip_mm")

    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        from ctrplan.planning.inverse_kinematics import inverse_kinematics  # slow to import, as OMPL is

        scenario = loaded.place
        goal = self._goal(loaded, scenario)
        tolerance_mm = float(goal["tolerance_mm"])
        within = goal.get("direction_tolerance_deg")
        result = inverse_kinematics(
            scenario,
            np.multiply(goal["tip_mm"], 1e-3),
            goal.get("direction"),
            tolerance_m=tolerance_mm * 1e-3,
            direction_tolerance_rad=None if within is None else float(np.radians(within)),
            starts=self.starts,
            seed=task.settings["seed"],
        )
        return _numbers(result)

    def _goal(self, loaded: Loaded, scenario: Scenario) -> dict[str, Any]:
        """tip_mm, tolerance_mm and, where they are given, direction and direction_tolerance_deg."""
        goal: dict[str, Any] = {"tolerance_mm": 1.0}
        if scenario.goal.tip_m is not None:
            goal = {"tip_mm": (scenario.goal.tip_m * 1e3).tolist(), "tolerance_mm": scenario.goal.tolerance_m * 1e3}
            if scenario.goal.direction is not None:
                goal["direction"] = scenario.goal.direction.tolist()
                goal["direction_tolerance_deg"] = float(np.degrees(scenario.goal.direction_tolerance_rad or np.pi))
        own = {key: getattr(self, key) for key in ("tip_mm", "tolerance_mm", "direction", "direction_tolerance_deg")}
        goal |= {key: value for key, value in own.items() if value is not None} | dict(loaded.target or {})
        if "tip_mm" not in goal:
            raise InputError("is missing: the study has no [targets], and there is no goal", key="task.tip_mm")
        return goal


def _numbers(solutions: InverseKinematics) -> Mapping[str, Any]:
    count, valid = len(solutions.configurations), solutions.valid
    known: dict[str, Any] = {
        "reached": bool(count),
        "valid": len(valid),
        "configurations": count,
        "nearest_mm": solutions.nearest.tip_error_m * 1e3,
    }
    if not valid:
        if not count:
            raise NoAnswer(solutions.sentence, known)
        reason = f"{solutions.sentence} "
        raise NoAnswer(reason.strip(), known)
    best = min(valid, key=lambda c: (not _keeps(solutions, c), c.worst_m))
    worst = {"worst_mm": best.worst_m * 1e3, "within_tolerance": _keeps(solutions, best)}
    return {**known, **_figures(solutions, best), **worst}


def _keeps(solutions: InverseKinematics, way: Configuration) -> bool:
    """Whether a configuration keeps both tolerances whatever friction and play do."""
    of = solutions.solutions
    return way.worst_m <= of.tolerance_m and way.worst_rad <= of.direction_tolerance_rad


def _figures(solutions: InverseKinematics, c: Configuration) -> dict[str, Any]:
    named = solutions.scenario.robot.drive.named(c.joints)
    return {
        "tip_error_mm": c.tip_error_m * 1e3,
        "bound_mm": c.bound_m * 1e3,
        "bound_deg": float(np.degrees(c.bound_rad)),
        "stability": c.stability,
        "max_strain": c.max_strain,
        "clearance_mm": c.clearance_m * 1e3,
        "joints": json.dumps({name: round(value, 9) for name, value in named.items()}),
    }


class NoAnswer(NoAnswerError):
    """No answer, with what is known all the same."""

    def __init__(self, sentence: str, numbers: Mapping[str, Any]) -> None:
        """numbers: for the table."""
        super().__init__(sentence)
        self.numbers = numbers
