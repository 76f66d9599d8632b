"""What a study is: what is varied, what is done with each combination, and the files that travel with the tasks."""

from __future__ import annotations

import os
import pickle
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from ctrplan.base.catalogue import code_version
from ctrplan.errors import InputError
from ctrplan.files.study_file import StudyEntry, VaryEntry, checked_study
from ctrplan.storage.toml_document import Document, TomlTable, chosen, read_document
from ctrplan.studies.study.axes import CONFIGURATION, TASK_PREFIX, Axis, axes_of, files_varied
from ctrplan.studies.study.sources import Sources
from ctrplan.studies.study.task import CATALOGUE, Job, Loaded, TaskKind, TaskList, check_settings

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

KEPT = {"none": (), "extremes": (), "all": ("plan.json", "trajectory.csv")}


@dataclass(frozen=True, eq=False)
class StudyDefinition:
    """Independent tasks, one for every combination of what is varied."""

    entry: StudyEntry
    document: Document
    kind: TaskKind
    sources: Sources
    axes: tuple[Axis, ...]
    job: Job
    tasks: TaskList

    @property
    def name(self) -> str:
        """The name in the file, else the file's own."""
        return self.entry.name or Path(self.document.file or "study").stem

    @property
    def count(self) -> int:
        """Number of tasks."""
        return self.tasks.count

    @cached_property
    def first(self) -> Loaded:
        """What the first task is about."""
        return Loaded(self.job, self.tasks[0])

    @property
    def robot(self) -> Robot:
        """The robot of the first task."""
        return self.first.robot

    @property
    def scenario(self) -> Scenario | None:
        """The scenario of the first task; None where the study is of a robot."""
        return None if self.job.is_robot else self.first.place

    @cached_property
    def task_s(self) -> float:
        """Seconds that one task takes on one core, roughly."""
        return self.kind.expected_s(self.robot, self.scenario)

    @property
    def content(self) -> bytes:
        """What every worker is given once."""
        return pickle.dumps(replace(self.job, tasks=self.tasks))


D = TypeVar("D", bound="FromFile")


class FromFile:
    """A dataclass that is made from a TOML file."""

    file_kind: ClassVar[str]

    @classmethod
    @abstractmethod
    def made_from(cls, document: Document, allow_outside: bool) -> Any:
        """An object with the same fields. Raises InputError."""

    @classmethod
    def read(
        cls: type[D], path: str | os.PathLike[str], overrides: Sequence[str] = (), *, allow_outside: bool = False
    ) -> D:
        """Reads a file after `overrides` such as "targets.step_mm=2"; docs/studies.md and docs/tube_design.md have the
        keys.

        Files that its scenario names must lie in the scenario's folder unless `allow_outside`. Raises InputError, one
        sentence, for anything malformed, keys that robot or scenario do not have, and files that do not exist.
        """
        return cls._of(read_document(path, overrides), allow_outside)

    @classmethod
    def of(
        cls: type[D], content: Mapping[str, Any], folder: str | os.PathLike[str] = ".", *, allow_outside: bool = False
    ) -> D:
        """Reads content as a file would hold it, files named relative to `folder`. Raises InputError as `read` does."""
        document = Document.of(content, cls.file_kind, str(Path(folder) / f"{cls.file_kind}.toml"))
        return cls._of(document, allow_outside)

    @classmethod
    def _of(cls: type[D], document: Document, allow_outside: bool) -> D:
        made = cls.made_from(document, allow_outside)
        return cls(*(getattr(made, field.name) for field in fields(made)))


def defined(document: Document, allow_outside: bool) -> StudyDefinition:
    """The study of a file. Raises InputError, one sentence, for anything malformed or contradictory."""
    entry = checked_study(document)
    folder = Path(document.file or ".").parent
    kind = chosen(TomlTable(document, ("task",)), "kind", CATALOGUE, TaskKind)
    start = "robot" if entry.robot is not None else "scenario"
    if start not in kind.needs:
        raise document.fault(f"is not what a {kind.kind} task is about: it needs a {kind.needs[0]}", start)
    if entry.targets is not None and not kind.uses_target and kind.kind != "function":
        raise document.fault(f"does not go with a {kind.kind} task", "targets")
    files = files_varied(entry, document)
    main = folder / (entry.robot or entry.scenario or "")
    if not main.is_file():
        raise document.fault("is not a file that exists", start)
    others = [folder / name for name in kind.files() if (folder / name).is_file()]
    sources = Sources.of([main, *others, *(file for some in files.values() for file in some)], folder)
    job = Job(
        sources=sources,
        main=sources.name(main),
        is_robot=start == "robot",
        task=dict(document.content["task"]),
        study_folder=sources.name(folder),
        allow_outside=allow_outside,
        numbers=tuple(entry.keep.numbers),
        keep=KEPT[entry.keep.plans],
    )
    scenario = None if job.is_robot or entry.targets is None else _unvaried(job)
    axes = tuple(axes_of(entry, document, sources, files, scenario))
    tasks = TaskList(axes, _base(entry, job, kind, axes), entry.seed)
    study = StudyDefinition(entry, document, kind, sources, axes, job, tasks)
    _check(study)
    return study


def _unvaried(job: Job) -> Scenario:
    """The scenario as it stands in its file, whose anatomy targets are chosen by."""
    from ctrplan.files.scenario_file import load_scenario

    return load_scenario(os.path.join(job.sources.folder, job.main), allow_outside=job.allow_outside)


def _base(entry: StudyEntry, job: Job, kind: TaskKind, axes: Sequence[Axis]) -> str:
    """Hash of what all tasks share: kind, files and version, but for what is varied."""
    import hashlib
    import json

    main_varies = any(getattr(axis, "is_main", False) for axis in axes)
    varied = [key for axis in axes for key in axis.keys]
    of_task = {key: value for key, value in job.task.items() if key != "time_limit_s"}
    content = {
        "version": code_version(),
        "task": of_task,
        "start": "" if main_varies else job.sources.digest(job.main, varied),
        "files": [job.sources.digest(job.sources.name(Path(job.sources.folder, job.study_folder, name)))
                  for name in kind.files() if job.sources.has(Path(job.study_folder, name))],
        "numbers": job.numbers,
    }  # fmt: skip
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def _check(study: StudyDefinition) -> None:
    """Raises InputError for keys that there are not: the first and the last choice of every axis are read."""
    settings = [vary.key for vary in study.entry.vary if vary.key.startswith(TASK_PREFIX)]
    check_settings(study.kind, [key.removeprefix(TASK_PREFIX) for key in settings], study.document.file)
    for vary in study.entry.vary:
        if CONFIGURATION.fullmatch(vary.key):
            _check_configuration(study, vary)
    for task in (study.tasks[0], study.tasks[study.count - 1]):
        try:
            loaded = Loaded(study.job, task)
            loaded.check()
            study.kind.check(task, loaded)
        except InputError as error:
            raise InputError(study.sources.with_original_paths(str(error)).rstrip(".")) from None


def _check_configuration(study: StudyDefinition, vary: VaryEntry) -> None:
    file = study.document.file
    if study.kind.kind != "bound":
        raise InputError("goes with a bound task only", file=file, key="vary", value=vary.key)
    for value in vary.values or ():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError("must be numbers", file=file, key=f"vary, values of {vary.key}", value=value)
