"""What a kind of task says about itself, and the catalogue of kinds; a kind is one file below studies/study/kinds/."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct

from ctrplan.base.catalogue import AbstractStruct, Catalogue
from ctrplan.errors import InputError
from ctrplan.storage.toml_document import Document

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario
    from ctrplan.robot.robot import Robot
    from ctrplan.studies.study.loaded import Loaded
    from ctrplan.studies.study.task import Job, Task

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
        """Of several tasks, each with its numbers or its error."""
        from ctrplan.studies.study.loaded import Loaded

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
