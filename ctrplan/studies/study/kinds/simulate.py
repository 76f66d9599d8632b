"""A simulation along a joint path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from ctrplan.errors import NoAnswerError
from ctrplan.storage.toml_document import Fraction
from ctrplan.studies.study.task import Loaded, TaskKind, register

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.studies.simulate import Simulation
    from ctrplan.studies.study.task import Task

PATH_S = 2.0  # of one core, for a path of some dozens of legs


@register("simulate")
class SimulateTask(TaskKind, frozen=True, kw_only=True):
    """kind = "simulate": as `ctrplan simulate`."""

    needs: ClassVar[tuple[Literal["robot", "scenario"], ...]] = ("robot",)
    best: ClassVar[str] = "largest_deviation_mm"

    path: str  # PATH.csv, relative to the study's folder
    start: Literal["released", "oscillated"] | list[Fraction | float] = "released"
    accuracy: Literal["search", "certificate"] = "search"

    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        return PATH_S

    def files(self) -> Sequence[str]:
        return (self.path,)

    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        from ctrplan.files.measurement_file import load_joint_path  # slow to import
        from ctrplan.studies.simulate import simulate

        robot = loaded.robot
        start = self.start if isinstance(self.start, str) else tuple(self.start)
        result = simulate(robot, load_joint_path(loaded.file(self.path), robot), start, accuracy=self.accuracy)
        if not result.is_complete:
            raise NoAnswerError(f"row {(result.failed_waypoint or 0) + 1}: no equilibrium was found on the way there.")
        return _numbers(result)


def _numbers(simulation: Simulation) -> Mapping[str, Any]:
    deviation_mm, bound_mm = simulation.deviation_m * 1e3, simulation.bounds.position_m * 1e3
    tip_mm = (simulation.position_m[-1] * 1e3).tolist()
    return {
        "largest_deviation_mm": float(np.nanmax(deviation_mm)),
        "last_deviation_mm": float(deviation_mm[-1]),
        "largest_bound_mm": float(np.nanmax(bound_mm)),
        "last_bound_mm": float(bound_mm[-1]),
        **{f"tip_{axis}_mm": value for axis, value in zip("xyz", tip_mm, strict=True)},
        "snaps": int(simulation.snaps.sum()),
    }
