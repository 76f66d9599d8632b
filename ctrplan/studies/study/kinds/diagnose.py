"""A diagnosis of measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from ctrplan.studies.study.task import Loaded, TaskKind, register

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.studies.study.task import Task

DIAGNOSIS_S = 300.0


@register("diagnose")
class DiagnoseTask(TaskKind, frozen=True, kw_only=True):
    """kind = "diagnose": as `ctrplan diagnose`."""

    needs: ClassVar[tuple[Literal["robot", "scenario"], ...]] = ("robot",)
    best: ClassVar[str] = "after_rms_mm"

    measurements: str  # MEASUREMENTS.csv, relative to the study's folder
    without: list[str] = []  # effects left out of the catalogue

    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        return DIAGNOSIS_S

    def files(self) -> Sequence[str]:
        return (self.measurements,)

    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        from ctrplan.diagnosis import diagnose  # slow to import
        from ctrplan.files.measurement_file import load_measurements

        robot = loaded.robot
        result = diagnose(robot, load_measurements(loaded.file(self.measurements), robot), without=self.without)
        content = result.to_json()
        figures = {key: value for key, value in content["gap"].items() if isinstance(value, (int, float))}
        effects = ", ".join(effect["name"] for effect in content["effects"])
        return {"verdict": result.verdict, "effects": effects, **figures, "coverage": result.coverage}
