"""One task of a study and the row that comes out of it: plain values, which any worker can take and give back."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from ctrplan.base.version import __version__
from ctrplan.studies.study.axes import Axis
from ctrplan.studies.study.sources import Sources

KEY_DIGITS = 24

Status = Literal["done", "no answer", "refused", "failed", "timed out", "lost"]
"""done; there is no answer; the input is malformed; an error; the time limit; the process that did it ended."""


@dataclass(frozen=True)
class Task:
    """A combination of choices."""

    index: int
    key: str  # hash of all that determines its row
    inputs: Mapping[str, Any]
    overrides: tuple[str, ...]
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Job:
    """What all tasks of a study share."""

    sources: Sources
    main: str  # the robot or scenario, unless a task names another
    is_robot: bool
    task: Mapping[str, Any]  # the content of [task]
    study_folder: str = "."  # which files of the task are named relative to
    allow_outside: bool = False
    version: str = __version__
    numbers: tuple[str, ...] = ()  # to record; none named: all
    keep: tuple[str, ...] = ()  # files of a plan that come back with its row
    tasks: TaskList | None = None  # those that workers are told by their numbers


@dataclass(frozen=True)
class Row:
    """What came out of a task."""

    key: str
    index: int
    inputs: Mapping[str, Any]
    status: Status
    reason: str = ""  # a sentence; empty where it is done
    numbers: Mapping[str, Any] = field(default_factory=dict)  # finite or not, or texts
    version: str = __version__
    seconds: float = 0.0  # of the processor's time; no result
    elapsed_s: float = 0.0  # likewise by the clock
    worker: str = ""  # where; no result
    overrides: tuple[str, ...] = ()
    files: Mapping[str, bytes] = field(default_factory=dict)


class TaskList:
    """Every combination of the axes' choices, the last axis running fastest; made one by one."""

    def __init__(self, axes: Sequence[Axis], base: str, seed: int, first: int = 0) -> None:
        """base: hash of what all tasks share. first: index of the first one."""
        self.axes, self.base, self.seed, self.first = tuple(axes), base, seed, first

    @property
    def count(self) -> int:
        """Number of tasks, which may be more than could ever be done."""
        return math.prod(len(axis) for axis in self.axes)

    def __getitem__(self, k: int) -> Task:
        """Task k of this list."""
        inputs, overrides, settings, digests = self._said(k)
        text = json.dumps([self.base, inputs, overrides, settings, digests], sort_keys=True)
        key = hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]
        return Task(self.first + k, key, inputs, tuple(overrides), settings)

    def made(self, k: int, index: int, key: str) -> Task:
        """Task k where its place in the table and its key are known."""
        inputs, overrides, settings, _ = self._said(k)
        return Task(index, key, inputs, tuple(overrides), settings)

    def _said(self, k: int) -> tuple[dict[str, Any], list[str], dict[str, Any], list[str]]:
        """Inputs, overrides, settings and digests of files of task k."""
        inputs: dict[str, Any] = {}
        overrides: list[str] = []
        settings: dict[str, Any] = {"seed": self.seed}
        digests = []
        for axis, choice in zip(self.axes, self._choices(k), strict=True):
            chosen = axis.at(choice)
            inputs |= chosen.inputs
            overrides += chosen.overrides
            settings |= chosen.settings
            digests.append(chosen.digest)
        return inputs, overrides, settings, digests

    def _choices(self, k: int) -> list[int]:
        choices = []
        for axis in reversed(self.axes):
            k, choice = divmod(k, len(axis))
            choices.append(choice)
        return choices[::-1]
