"""`ctrplan.Study`: a study from its file or content, and what is done with it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields
from pathlib import Path
from typing import Any

from ctrplan.files.study_entries import StudyEntry
from ctrplan.files.study_file import checked_study, read_study
from ctrplan.storage.toml_document import Document
from ctrplan.studies.study.definition import Definition, defined
from ctrplan.studies.study.run import Report, Where, run_study
from ctrplan.studies.study.table import StudyTable, load_study


class Study(Definition):
    """Independent tasks, one for every combination of what is varied; made by `Study.read` or `Study.of`."""

    load = staticmethod(load_study)

    @classmethod
    def read(cls, path: str | os.PathLike[str], overrides: Sequence[str] = (), *, allow_outside: bool = False) -> Study:
        """The study of a TOML file after `overrides` such as "draws.count=1000"; docs/studies.md has the keys.

        Files that its scenario names must lie in the scenario's folder unless `allow_outside`. Raises InputError, one
        sentence, for anything malformed, keys that robot or scenario do not have, and files that do not exist.
        """
        entry, document = read_study(path, overrides)
        return cls._of(entry, document, allow_outside)

    @classmethod
    def of(
        cls, content: Mapping[str, Any], folder: str | os.PathLike[str] = ".", *, allow_outside: bool = False
    ) -> Study:
        """Likewise of a study file's content; files are named relative to `folder`."""
        document = Document.of(content, "study", str(Path(folder) / "study.toml"))
        return cls._of(checked_study(document), document, allow_outside)

    def run(
        self,
        folder: str | os.PathLike[str],
        *,
        executor: Executor | None = None,
        workers: int | None = None,
        scheduler: str | None = None,
        scheduler_file: str | None = None,
        add: bool = False,
        yes: bool = False,
        progress: Report | None = None,
    ) -> StudyTable:
        """Does what is missing in the folder, and returns the table; see `run.run_study`. Raises CtrplanError."""
        where = Where(executor, workers, scheduler, scheduler_file)
        return run_study(self, folder, where, add=add, yes=yes, progress=progress).table

    @classmethod
    def _of(cls, entry: StudyEntry, document: Document, allow_outside: bool) -> Study:
        made = defined(entry, document, allow_outside)
        return cls(*(getattr(made, field.name) for field in fields(made)))
