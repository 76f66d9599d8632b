"""Tasks of a study by their numbers, what they read, the rows that come out of them, and the catalogue of their
kinds.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import math
from abc import abstractmethod
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct

from ctrplan.base.catalogue import AbstractStruct, Catalogue, code_version
from ctrplan.errors import InputError
from ctrplan.storage.toml_document import Document
from ctrplan.studies.study.axes import OTHER_WAYS, POSE, Axis
from ctrplan.studies.study.sources import Sources

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

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
    version: str = field(default_factory=code_version)
    numbers: tuple[str, ...] = ()  # to record; none named: all
    keep: tuple[str, ...] = ()  # files of a plan that come back with its row
    tasks: TaskList | None = None  # those that workers are told by their numbers


@dataclass(frozen=True)
class TaskRow:
    """What came out of a task."""

    key: str
    index: int
    inputs: Mapping[str, Any]
    status: Status
    reason: str = ""  # a sentence; empty where it is done
    numbers: Mapping[str, Any] = field(default_factory=dict)  # finite or not, or texts
    version: str = field(default_factory=code_version)
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
        overrides.sort(key=lambda text: not text.startswith(OF_TARGET))  # what is varied of a goal comes after it
        return inputs, overrides, settings, digests

    def _choices(self, k: int) -> list[int]:
        choices = []
        for axis in reversed(self.axes):
            k, choice = divmod(k, len(axis))
            choices.append(choice)
        return choices[::-1]


KEY_BYTES = KEY_DIGITS // 2


@dataclass(frozen=True)
class TaskNumbers:
    """Tasks of a list: their numbers in it, their places in the table and their keys, KEY_BYTES each."""

    numbers: array[int]
    indices: array[int]
    keys: bytes | bytearray

    @classmethod
    def none(cls) -> TaskNumbers:
        """To which some may be added."""
        return cls(array("q"), array("q"), bytearray())

    def __len__(self) -> int:
        """Number of tasks."""
        return len(self.numbers)

    def add(self, number: int, index: int, key: bytes) -> None:
        """One more. Only of those that began as none."""
        assert isinstance(self.keys, bytearray)
        self.numbers.append(number)
        self.indices.append(index)
        self.keys.extend(key)

    def chunks(self, sizes: Iterable[int]) -> Iterator[TaskNumbers]:
        """All of them in their order, so many at a time."""
        begin = 0
        for size in sizes:
            end = min(begin + size, len(self))
            if begin == end:
                return
            yield self._some(begin, end)
            begin = end

    def of(self, tasks: TaskList) -> list[Task]:
        """The tasks."""
        keys = (self.keys[k : k + KEY_BYTES].hex() for k in range(0, len(self.keys), KEY_BYTES))
        result = zip(self.numbers, self.indices, keys, strict=True)
        return [tasks.made(number, index, key) for number, index, key in result]

    def _some(self, begin: int, end: int) -> TaskNumbers:
        keys = bytes(self.keys[begin * KEY_BYTES : end * KEY_BYTES])
        return TaskNumbers(self.numbers[begin:end], self.indices[begin:end], keys)


OF_TARGET = ("goal=", "target=")  # overrides that change the goal and nothing else
TURNS_BASE = ("base=", *(f"base.{way}=" for way in (POSE[1], *OTHER_WAYS, "rotation_matrix")))


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
        """The scenario but for the goal, the same for many targets: what is known of its anatomy is computed once."""
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
        result = _scenario(str(self.main), tuple(overrides), self.job.allow_outside)
        if any(text.startswith(TURNS_BASE) for text in overrides):
            from ctrplan.scenario.sizes import refuse_loads  # with all of the anatomy behind it

            refuse_loads(result.robot, result.robot.path, "effects")
        return result


@lru_cache(maxsize=2)
def _robot(path: str, overrides: tuple[str, ...]) -> Robot:
    from ctrplan.files.robot_file import load_robot

    return load_robot(path, overrides)


@lru_cache(maxsize=2)
def _scenario(path: str, overrides: tuple[str, ...], allow_outside: bool) -> Scenario:
    from ctrplan.files.scenario_file import load_robot_or_scenario

    return load_robot_or_scenario(path, overrides, allow_outside=allow_outside)


for _kept in (_robot, _scenario):
    atexit.register(_kept.cache_clear)  # what lives on when the interpreter has ended counts as leaked
Start = Literal["robot", "scenario"]
T = TypeVar("T", bound="type[TaskKind]")


class Done(dict[str, Any]):
    """Numbers of a task, and the files that are kept beside them."""

    def __init__(self, numbers: Mapping[str, Any], files: Mapping[str, bytes]) -> None:
        """files: content by name."""
        super().__init__(numbers)
        self.files = files


class TaskKind(Struct, metaclass=AbstractStruct, forbid_unknown_fields=True, kw_only=True, frozen=True):
    """[task]: what every kind has. A kind adds keys of its own, each of which may be varied as task.KEY."""

    needs: ClassVar[tuple[Start, ...]] = ("robot", "scenario")  # what a study of this kind may be of
    uses_target: ClassVar[bool] = False
    best: ClassVar[str] = ""  # the column that says which row is best, least first
    together: ClassVar[bool] = False  # whether several tasks in one go are faster than one after the other

    kind: str
    time_limit_s: Annotated[float, Meta(gt=0, le=1e7)] | None = None  # of each task, which is ended then

    @abstractmethod
    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        """Seconds that one task takes on one core, roughly."""

    @abstractmethod
    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        """What the table gets of a task. Raises CtrplanError."""

    def rows(self, tasks: Sequence[Task], job: Job) -> Iterator[tuple[Task, Mapping[str, Any] | Exception]]:
        """Rows of several tasks, each with its numbers or its error."""
        for task in tasks:
            try:
                loaded = Loaded(job, task)
                yield task, Done(settled(self, task).numbers(task, loaded), loaded.files)
            except Exception as error:
                yield task, error

    def check(self, task: Task, loaded: Loaded) -> None:  # noqa: B027 (most have nothing that needs it)
        """Raises InputError for a task of the study, the first or the last one, that no robot could do."""

    def files(self) -> Sequence[str]:
        """Files beside the robot or scenario that tasks read, relative to the study's folder."""
        return ()


CATALOGUE: Catalogue[type[TaskKind]] = Catalogue("task kind", "ctrplan.studies.study.kinds")


def register(name: str) -> Callable[[T], T]:
    """Adds a kind to the catalogue: the decorator of its class."""

    def registered(kind: T) -> T:
        CATALOGUE.require(kind, ())
        CATALOGUE.add(name, kind, kind.__module__)
        return kind

    return registered


def settled(kind: TaskKind, task: Task) -> TaskKind:
    """The kind with what the task says of its keys. Raises InputError for what does not fit."""
    own = {key: value for key, value in task.settings.items() if key in _keys(type(kind))}
    if not own:
        return kind
    return Document({**msgspec.to_builtins(kind), **own}).to(type(kind))


@lru_cache
def _keys(kind: type[TaskKind]) -> frozenset[str]:
    return frozenset(field.name for field in msgspec.structs.fields(kind))


def check_settings(kind: TaskKind, keys: Sequence[str], file: str | None) -> None:
    """Raises InputError for a varied key of the task that its kind does not have."""
    import difflib

    fields = [field.name for field in msgspec.structs.fields(kind) if field.name != "kind"]
    for key in keys:
        if key not in fields:
            close = difflib.get_close_matches(key, fields, n=1)
            known = f"did you mean task.{close[0]}?" if close else f"known ones are {', '.join(fields)}"
            raise InputError(f"unknown key of a {kind.kind} task, {known}", file=file, key="vary", value=f"task.{key}")
