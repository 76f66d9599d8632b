"""One table within a TOML file, and the member of a catalogue that it names."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ctrplan.base.catalogue import Catalogue
from ctrplan.errors import InputError
from ctrplan.storage.toml_document import Document, Step
from ctrplan.storage.toml_faults import first_fault, rule_of_options

T = TypeVar("T", bound=msgspec.Struct)


@dataclass(frozen=True)
class TomlTable:
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

    def replaced(self, content: Mapping[str, Any], without: Sequence[str] = ()) -> TomlTable:
        """This place in a document that has `content` there, and lacks the top-level keys `without`."""
        whole: dict[str, Any] = {key: value for key, value in self.document.content.items() if key not in without}
        node: Any = whole
        for step in self.path[:-1]:
            node[step] = copy.copy(node[step])
            node = node[step]
        node[self.path[-1]] = dict(content)
        return TomlTable(Document(whole, self.document.file), self.path, self.allow_outside)

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
        """The path of a file or a folder that the key names."""
        return _inside(name, self.document, self.allow_outside, Path.exists, *self.path, *path)


def file_inside(name: str, document: Document, allow_outside: bool, *path: Step) -> Path:
    """The file that key `path` names, relative to the document's folder.

    Raises InputError when it lies outside that folder, unless allowed, or does not exist.
    """
    return _inside(name, document, allow_outside, Path.is_file, *path)


def path_inside(name: str, document: Document, *path: Step) -> Path:
    """The file or folder that key `path` names, which must lie in the document's folder or below and exist."""
    return _inside(name, document, False, Path.exists, *path)


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


Entry = TypeVar("Entry", bound=msgspec.Struct)


def chosen(
    table: TomlTable,
    by: str,
    catalogue: Catalogue[type[Entry]],
    common: type[msgspec.Struct],
    default: str | None = None,
) -> Entry:
    """The table as the catalogue's schema that its key `by` names; all of them have the keys of `common`.

    default: what it names where the key is missing. Raises InputError for a name that is not in the catalogue, for a
    key of another schema than the one named, for one that is missing, and for what does not fit.
    """
    name = _name(table, by, catalogue, default)
    own = {other: _own_fields(schema, common) for other, schema in catalogue.items()}
    for key in sorted(table.content):
        if key not in own[name] and any(key in keys for keys in own.values()):
            raise table.fault(f"does not go with {by} = '{name}'", key)
    for key in _required(catalogue[name]):
        if key not in table.content and key != by:
            raise table.fault(f"is missing, a {name} needs {', '.join(own[name])}", key)
    return table.to(catalogue[name])


def _name(table: TomlTable, by: str, catalogue: Catalogue[type[Entry]], default: str | None) -> str:
    name = table.content.get(by, default)
    if name is None:
        raise table.fault("is missing", by)
    if not isinstance(name, str) or name not in catalogue:
        raise table.fault(rule_of_options(catalogue.names.split(", "), by, name), by)
    return name


def _own_fields(schema: type[msgspec.Struct], common: type[msgspec.Struct]) -> Sequence[str]:
    shared = {field.name for field in msgspec.structs.fields(common)}
    return [field.name for field in msgspec.structs.fields(schema) if field.name not in shared]


def _required(schema: type[msgspec.Struct]) -> Sequence[str]:
    return [field.name for field in msgspec.structs.fields(schema) if field.required]
