"""A plan."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from ctrplan.studies.study.task import Loaded, TaskKind, register

if TYPE_CHECKING:
    from ctrplan.plans.plan import Plan
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.studies.study.task import Task

CERTIFICATE_S = 6.0  # beside the search


@register("plan")
class PlanTask(TaskKind, frozen=True, kw_only=True):
    """kind = "plan": as `ctrplan plan`, without a bound field, so that every machine finds the same.

    Searches are counted, not timed, unless time_s is given: then results depend on the machine.
    """

    needs: ClassVar[tuple[Literal["robot", "scenario"], ...]] = ("scenario",)
    uses_target: ClassVar[bool] = True
    best: ClassVar[str] = "worst_mm"

    time_s: Annotated[float, Meta(gt=0, le=3600)] | None = None  # of search, by the clock
    compensate: bool = True

    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        search_s = self.time_s or (scenario.planner.time_s if scenario else 5.0)
        return float(search_s) + CERTIFICATE_S

    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        from ctrplan.planning import plan  # slow to import, as OMPL is

        result = plan(loaded.scenario, seed=task.settings["seed"], time_s=self.time_s, compensated=self.compensate)
        loaded.files |= _files(result, loaded.job.keep)
        return _numbers(result)


def _numbers(result: Plan) -> Mapping[str, Any]:
    """Numbers of the certificate; "worst" and arrival of a tour are those of the target where they are worst."""
    certificate = result.certificate
    worst_m = max(target.tip_error_m + target.bound_m + target.play_m for target in certificate.targets)
    numbers = {
        "valid": bool(certificate.valid),
        "worst_mm": float(worst_m * 1e3),
        "goal_tip_error_mm": certificate.goal_tip_error_m * 1e3,
        "goal_bound_mm": certificate.goal_bound_m * 1e3,
        "worst_bound_mm": certificate.worst_bound_m * 1e3,
        "goal_predicted_mm": certificate.goal_predicted_m * 1e3,
        "clearance_mm": certificate.min_clearance_m * 1e3,
        "stability": certificate.min_stability,
        "max_strain": certificate.max_strain,
        "cost_mm": certificate.cost_mm,
        "length_mm": certificate.length_mm,
        "stops": certificate.stops,
        "legs": len(result.legs),
        "duration_s": result.trajectory.duration_s,
    }
    goals = result.scenario.targets[-len(certificate.targets) :]
    tips = [(goal, at.arrival) for goal, at in zip(goals, certificate.targets, strict=True) if goal.tip_m is not None]
    if tips:
        arrival_m = max(arrival.error_m if arrival else np.inf for _, arrival in tips)
        is_within = all(arrival is not None and arrival.keeps(goal) for goal, arrival in tips)
        numbers |= {"arrival_mm": arrival_m * 1e3, "within_tolerance": is_within}
    return {name: value.item() if isinstance(value, np.generic) else value for name, value in numbers.items()}


def _files(result: Plan, wanted: Sequence[str]) -> dict[str, bytes]:
    """What is asked for of the files of a plan's folder."""
    from ctrplan.files.trajectory_file import trajectory_formats, write_trajectory
    from ctrplan.plans.plan import write_plan_json
    from ctrplan.plans.planned_motion import marked_trajectory

    if not wanted:
        return {}
    with tempfile.TemporaryDirectory() as name:
        made = Path(name)
        if set(wanted) <= {"plan.json", "trajectory.csv"}:
            write_plan_json(made / "plan.json", result)
            write_trajectory(made, marked_trajectory(result), trajectory_formats(["csv"]))
        else:
            result.save(made)
        return {name: (made / name).read_bytes() for name in wanted}
