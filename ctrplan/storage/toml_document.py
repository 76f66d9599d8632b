"""Strict reading of the TOML files people write: every fault is one sentence with file, key, value, unit and rule."""

from __future__ import annotations

import copy
import csv
import hashlib
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec
import numpy as np

from ctrplan.errors import InputError
from ctrplan.storage.file_bytes import file_bytes, file_name
from ctrplan.storage.number_ranges import LARGEST_NUMBER
from ctrplan.storage.toml_faults import first_fault, unit_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LARGEST_FILE_BYTES = 1_000_000
DEEPEST_KEY = 20
LONGEST_POSITION = 9  # digits

T = TypeVar("T", bound=msgspec.Struct)
Step = str | int  # one step of a key: a name, or a position counted from 0 (people see it counted from 1)


@dataclass(frozen=True)
class Document:
    """The content of one TOML file and the name under which sentences mention it."""

    content: dict[str, Any]
    file: str | None = None

    @property
    def sha256(self) -> str:
        """Hash of the content alone: layout, comments, order of keys and 1 or 1.0 make no difference."""
        numbers_as_floats = json.loads(json.dumps(self.content, default=str), parse_int=float)
        return hashlib.sha256(json.dumps(numbers_as_floats, sort_keys=True).encode()).hexdigest()

    def to(self, schema: type[T]) -> T:
        """The content as `schema`. Raises InputError for the first thing that does not fit."""
        try:
            found = dict(_numbers(self.content))
            for path in (path for path, value in found.items() if not abs(value) <= sys.float_info.max):
                raise self.fault("must be a finite number", *path)
            entry = msgspec.convert(self.content, schema)
            for path in (path for path, value in found.items() if abs(value) > LARGEST_NUMBER):
                raise self.fault(f"must be from {-LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}", *path)
            return entry
        except RecursionError:
            raise self.fault("is nested too deeply") from None
        except msgspec.ValidationError as error:
            path, rule = first_fault(self.content, schema) or ((), f"can't be read: {error}")
            raise self.fault(rule, *path) from None

    def fault(self, rule: str, *path: Step, unit: str | None = None) -> InputError:
        """The error that the value at `path` breaks `rule`; its unit comes from the key's suffix unless given."""
        value = self._value(path)
        is_table = isinstance(value, dict) or isinstance(value, list) and any(isinstance(v, dict) for v in value)
        names = [step for step in path if isinstance(step, str)]
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return InputError(
            rule,
            file=self.file,
            key=".".join((step or '""') if isinstance(step, str) else str(step + 1) for step in path) or None,
            value=... if is_table else value,
            unit=unit or (unit_of(names[-1]) if names and is_number else None),
        )

    def with_overrides(self, overrides: Sequence[str]) -> Document:
        """A copy after assignments such as "tube.2.poisson_ratio=0.28" (positions from 1, the value in TOML)."""
        content = copy.deepcopy(self.content)
        for assignment in checked_overrides(overrides):
            _assign(content, assignment, self.file)
        return Document(content, self.file)

    @classmethod
    def of(cls, content: Mapping[str, Any], kind: str, file: str | None = None) -> Document:
        """The content of a `kind` of file, "robot" or "scenario", given as a mapping; `file` is what errors call it.

        Numbers of numpy become Python's, which a file would hold. Raises InputError for what no file could hold.
        """
        if not isinstance(content, Mapping):
            raise InputError(f"must be a mapping with the keys of a {kind} file", file=file, value=content)
        try:
            return cls(_plain(content), file)
        except RecursionError:
            raise InputError("is nested too deeply", file=file) from None

    def _value(self, path: Sequence[Step]) -> Any:
        value: Any = self.content
        for step in path:
            try:
                value = value[step]
            except (KeyError, IndexError, TypeError):
                return ...
        return value


def read_document(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Document:
    """The TOML file at `path` after `overrides`. Raises InputError when it can't be read or is no TOML."""
    file = file_name(path, "a TOML file")
    data = file_bytes(file, LARGEST_FILE_BYTES, "TOML", "robot or scenario file")
    try:
        return Document(_parse(data, file), file).with_overrides(overrides)
    except RecursionError:
        raise InputError("is nested too deeply", file=file) from None


def _parse(data: bytes, file: str) -> dict[str, Any]:
    try:
        content: dict[str, Any] = tomllib.loads(data.decode("utf-8-sig"))
        return content
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 text (byte {error.start})", file=file) from None
    except tomllib.TOMLDecodeError as error:
        message, _, place = str(error).rstrip(")").partition(" (at ")
        raise InputError(f"is not valid TOML at {place or 'an unknown place'}: {message}", file=file) from None
    except ValueError:
        raise InputError("holds a number with thousands of digits", file=file) from None


def checked_overrides(overrides: Sequence[str]) -> Sequence[str]:
    """The overrides, if they are a list of texts. Raises InputError."""
    if isinstance(overrides, (list, tuple)) and all(isinstance(assignment, str) for assignment in overrides):
        return overrides
    raise InputError("must be a list of texts such as tube.2.poisson_ratio=0.28", key="overrides", value=overrides)


def override_names(key: str) -> list[str]:
    """The steps of an override's key: split at dots, except inside "...", positions without leading zeros."""
    try:
        names = next(csv.reader([key], delimiter="."), [])
    except csv.Error:
        return []
    return [str(int(name)) if name.isdecimal() and len(name) <= LONGEST_POSITION else name for name in names]


def _assign(content: dict[str, Any], assignment: str, file: str | None) -> None:
    key, equals, text = (part.strip() for part in assignment.partition("="))
    names = override_names(key)
    if not equals or not names or not all(names):
        raise InputError("an override has the form key=value, such as tube.2.poisson_ratio=0.28", value=assignment)
    node: Any = content
    for depth, name in enumerate(names):
        shown = ".".join(names[: depth + 1])
        step: Step = name
        if isinstance(node, list):
            if not (name.isdecimal() and 1 <= int(name) <= len(node)):
                raise InputError(f"no such entry to override: positions go from 1 to {len(node)}", file=file, key=shown)
            step = int(name) - 1
        elif not isinstance(node, dict):
            parent = ".".join(names[:depth])
            raise InputError(f"no such key to override: {parent} is a single value", file=file, key=shown)
        if depth == len(names) - 1:
            node[step] = _toml_value(text)
        else:
            node = node.setdefault(step, {}) if isinstance(node, dict) else node[step]


def _toml_value(text: str) -> Any:
    """`text` as a TOML value; text that is none stands for itself, so that quotes are not needed in a shell."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if list(parsed) == ["value"] else text


def _plain(content: Any) -> Any:
    """The content with numbers of numpy as Python's."""
    if isinstance(content, Mapping):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, (list, tuple, np.ndarray)):
        return [_plain(value) for value in content]
    return content.item() if isinstance(content, np.generic) else content


def _numbers(value: Any, path: tuple[Step, ...] = ()) -> Iterator[tuple[tuple[Step, ...], float]]:
    if len(path) > DEEPEST_KEY:
        raise RecursionError
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, (*path, key))
    elif isinstance(value, (list, tuple)):
        for position, item in enumerate(value):
            yield from _numbers(item, (*path, position))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, value
