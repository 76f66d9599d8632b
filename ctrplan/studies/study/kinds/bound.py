"""The friction bound at one configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import rows_in_a_chunk
from ctrplan.robot.robot import nesting_violation
from ctrplan.storage.toml_document import Angle, Coordinate
from ctrplan.studies.study.axes import CONFIGURATION
from ctrplan.studies.study.task import Loaded, TaskKind, register, settled

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.studies.study.task import Job, Task

CHUNK_S = 0.3  # of one core's time that `rows_in_a_chunk` rows take


@register("bound")
class BoundTask(TaskKind, frozen=True, kw_only=True):
    """kind = "bound": at commanded rotations and translations, a scenario's at its start unless they are given."""

    best: ClassVar[str] = "bound_mm"
    together: ClassVar[bool] = True

    theta_deg: list[Angle] | None = None
    l_mm: list[Coordinate] | None = None
    accuracy: Literal["search", "certificate", "exact"] = "search"

    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        return CHUNK_S / rows_in_a_chunk(robot.n, self.accuracy)

    def check(self, task: Task, loaded: Loaded) -> None:
        self._commanded(loaded.robot, loaded, [task])

    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        (result,) = self._of_one_robot([task], loaded)
        if isinstance(result[1], Exception):
            raise result[1]
        return result[1]

    def rows(self, tasks: Sequence[Task], job: Job) -> Iterator[tuple[Task, Mapping[str, Any] | Exception]]:
        for _, some in groupby(tasks, key=lambda task: (task.overrides, task.settings.get("file"), _accuracy(task))):
            alike = list(some)
            try:
                kind = settled(self, alike[0])
                assert isinstance(kind, BoundTask)
                yield from kind._of_one_robot(alike, Loaded(job, alike[0]))
            except Exception as error:  # of the robot, or of a solve of them all
                yield from ((task, error) for task in alike)

    def _of_one_robot(self, tasks: Sequence[Task], loaded: Loaded) -> list[tuple[Task, Mapping[str, Any] | Exception]]:
        robot = loaded.robot
        results: dict[int, Mapping[str, Any] | Exception] = {}
        theta, l = self._commanded(robot, loaded, tasks)  # noqa: E741
        theta_b, l_b = robot.collars(theta, l)
        if robot.mechanics.first_refused(theta_b, l_b):
            for k in range(len(tasks)):
                if sentence := nesting_violation(robot, theta_b[k], l_b[k]):
                    shown = (l[k] * 1e3).round(6).tolist()
                    results[k] = InputError(sentence, key="l_mm", value=shown, unit="mm")
        rows = np.array([k for k in range(len(tasks)) if k not in results], dtype=int)
        if len(rows):
            bounds = robot.bound_many(theta_b[rows], l_b[rows], accuracy=self.accuracy)
            for row, k in enumerate(rows.tolist()):
                results[k] = _numbers(bounds, row)
        return [(task, results[k]) for k, task in enumerate(tasks)]

    def _commanded(self, robot: Robot, loaded: Loaded, tasks: Sequence[Task]) -> tuple[Array, Array]:
        """(K, n) [rad], (K, n) [m]. Raises InputError."""
        if self.theta_deg is None and self.l_mm is None:
            theta, l = robot.drive.commanded(loaded.place.start)  # noqa: E741
        else:
            theta, l = _degrees(self.theta_deg, robot), _millimetres(self.l_mm, robot)  # noqa: E741
        tables = {"theta": np.tile(theta, (len(tasks), 1)), "l": np.tile(l, (len(tasks), 1))}
        for k, task in enumerate(tasks):
            for key, value in task.settings.items():
                if match := CONFIGURATION.fullmatch(key):
                    if not 1 <= int(match[2]) <= robot.n:
                        raise InputError(f"no such tube, they are counted from 1 (outermost) to {robot.n}", key=key)
                    unit = np.pi / 180 if match[1] == "theta" else 1e-3
                    tables[match[1]][k, int(match[2]) - 1] = value * unit
        return tables["theta"], tables["l"]


def _accuracy(task: Task) -> Any:
    return task.settings.get("accuracy"), str(task.settings.get("theta_deg")), str(task.settings.get("l_mm"))


def _degrees(values: list[float] | None, robot: Robot) -> Array:
    return np.radians(_counted("theta_deg", values, robot))


def _millimetres(values: list[float] | None, robot: Robot) -> Array:
    return np.multiply(_counted("l_mm", values, robot), 1e-3)


def _counted(key: str, values: list[float] | None, robot: Robot) -> list[float]:
    if values is None or len(values) != robot.n:
        raise InputError(
            f"needs {robot.n} values, one per tube, outermost first", key=f"task.{key}", value=values or []
        )
    return values


def _numbers(bounds: Any, row: int) -> Mapping[str, Any] | Exception:
    """Numbers of one configuration; as an error where no bound is promised."""
    status = Status(int(bounds.status[row]))
    if not np.isfinite(bounds.position_m[row]):
        return NoAnswerError(f"no bound is promised at this configuration ({status.name}).")
    if status is Status.UNSTABLE:
        return NoAnswerError("the configuration is elastically unstable: the robot snaps away, no bound is promised.")
    tip_mm = (bounds.tip_m[row] * 1e3).tolist()
    return {
        "bound_mm": float(bounds.position_m[row] * 1e3),
        "bound_deg": float(np.degrees(bounds.tangent_rad[row])),
        "stability": float(bounds.stability[row]),
        "max_strain": float(bounds.max_strain[row]),
        **{f"tip_{axis}_mm": value for axis, value in zip("xyz", tip_mm, strict=True)},
        "solution": status.name,
    }
