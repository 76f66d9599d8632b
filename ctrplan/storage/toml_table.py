"""One table within a TOML file: read strictly, with sentences that name the file and the whole key."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ctrplan.errors import InputError
from ctrplan.storage.toml_document import Document, Step
from ctrplan.storage.toml_faults import first_fault

T = TypeVar("T", bound=msgspec.Struct)


@dataclass(frozen=True)
class Table:
    """The table at `path` of a document (positions from 0).

    allow_outside: whether files that it names may lie outside the document's folder.
    """

    document: Document
    path: tuple[Step, ...]
    allow_outside: bool = False

    @property
    def content(self) -> Mapping[str, Any]:
        """What stands in the table; empty where there is none."""
        value: Any = self.document.content
        for step in self.path:
            value = value.get(step, {}) if isinstance(step, str) else value[step]
        return dict(value)

    def replaced(self, content: Mapping[str, Any], without: Sequence[str] = ()) -> Table:
        """The same place in a document that has `content` there, and lacks the top-level keys `without`."""
        whole: dict[str, Any] = {key: value for key, value in self.document.content.items() if key not in without}
        node: Any = whole
        for step in self.path[:-1]:
            node[step] = copy.copy(node[step])
            node = node[step]
        node[self.path[-1]] = dict(content)
        return Table(Document(whole, self.document.file), self.path, self.allow_outside)

    def to(self, schema: type[T]) -> T:
        """The table as `schema`. Raises InputError for the first thing that does not fit."""
        content = dict(self.content)
        try:
            return msgspec.convert(content, schema)
        except msgspec.ValidationError as error:
            path, rule = first_fault(content, schema) or ((), f"can't be read: {error}")
            raise self.fault(rule, *path) from None

    def fault(self, rule: str, *path: Step, unit: str | None = None) -> InputError:
        """The error that the value at `path` within the table breaks `rule`."""
        return self.document.fault(rule, *self.path, *path, unit=unit)

    def key(self, *path: Step) -> str:
        """The whole key of what stands at `path` within the table, positions counted from 1."""
        return ".".join(str(step + 1) if isinstance(step, int) else step for step in (*self.path, *path))

    def file(self, name: str, *path: Step) -> Path:
        """The file that key `path` of the table names, as `file_inside`."""
        return file_inside(name, self.document, self.allow_outside, *self.path, *path)

    def place(self, name: str, *path: Step) -> Path:
        """Likewise a file or a folder."""
        return _inside(name, self.document, self.allow_outside, Path.exists, *self.path, *path)


def file_inside(name: str, document: Document, allow_outside: bool, *path: Step) -> Path:
    """The file that key `path` names, relative to the document's folder.

    Raises InputError when it lies outside that folder, unless allowed, or does not exist.
    """
    return _inside(name, document, allow_outside, Path.is_file, *path)


def _inside(name: str, document: Document, allow_outside: bool, is_there: Callable[[Path], bool], *path: Step) -> Path:
    folder = Path(document.file or ".").parent
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
        exists = is_there(folder / name)
    except (OSError, ValueError, RuntimeError):  # a NUL in the name, a loop of links, a closed folder
        inside, exists = True, False
    if not (inside or allow_outside):
        raise document.fault("must lie in the folder of this file or below", *path)
    if not exists:
        raise document.fault("is not a file that exists", *path)
    return folder / name
