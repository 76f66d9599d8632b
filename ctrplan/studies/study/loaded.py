"""What a task is about, read from the files that came with it; read once for tasks that follow each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario
    from ctrplan.robot.robot import Robot
    from ctrplan.studies.study.task import Job, Task

OF_TARGET = ("goal=", "target=")  # overrides that change the goal and nothing else


class Loaded:
    """Robot, scenario and files of one task."""

    def __init__(self, job: Job, task: Task) -> None:
        """Reads nothing yet."""
        self.job, self.task = job, task
        self.files: dict[str, bytes] = {}  # what is to be kept beside the row

    @property
    def main(self) -> Path:
        """The robot's or scenario's file, on this machine."""
        name: str = self.task.settings.get("file", self.job.main)
        return self.job.sources.here / name

    @property
    def target(self) -> Mapping[str, Any] | None:
        """What the study says of the goal: tip_mm and possibly tolerance_mm, direction, direction_tolerance_deg."""
        target: Mapping[str, Any] | None = self.task.settings.get("target")
        return target

    @property
    def scenario(self) -> Scenario:
        """With everything that the task changes; of a robot alone, in free space. Raises InputError."""
        return self._read(self.task.overrides)

    @property
    def place(self) -> Scenario:
        """Likewise but for the goal, the same for many targets: what is known of its anatomy is computed once."""
        return self._read(tuple(text for text in self.task.overrides if not text.startswith(OF_TARGET)))

    @property
    def robot(self) -> Robot:
        """With everything that the task changes. Raises InputError."""
        if not self.job.is_robot:
            return self.place.robot
        return _robot(str(self.main), self.task.overrides)

    def check(self) -> None:
        """Raises InputError for what the task changes that there is not."""
        if self.job.is_robot:
            _ = self.robot
        else:
            self._read(self.task.overrides)

    def file(self, name: str) -> Path:
        """A file that the task's kind names, on this machine. Raises InputError."""
        path = self.job.sources.here / self.job.study_folder / name
        if not path.is_file():
            raise InputError("is not a file that came with the study", key="task", value=name)
        return path

    def _read(self, overrides: Sequence[str]) -> Scenario:
        return _scenario(str(self.main), tuple(overrides), self.job.allow_outside)


@lru_cache(maxsize=2)
def _robot(path: str, overrides: tuple[str, ...]) -> Robot:
    from ctrplan.files.robot_file import load_robot

    return load_robot(path, overrides)


@lru_cache(maxsize=2)
def _scenario(path: str, overrides: tuple[str, ...], allow_outside: bool) -> Scenario:
    from ctrplan.files.bare_scenario import load_robot_or_scenario

    return load_robot_or_scenario(path, overrides, allow_outside=allow_outside)
