"""Strict reading of the TOML files people write, of their tables and of the members of catalogues that these name, and
writing them: every fault is one sentence with file, key, value and rule.

No number of a file is without a range: beyond it a value is in another unit, or nothing can be computed with it.
`LARGEST_NUMBER` holds where a file's table is read by whoever extends ctrplan and states none.
"""

from __future__ import annotations

import copy
import csv
import hashlib
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
import tomli_w
from msgspec import Meta

from ctrplan.base.arrays import LONGEST_MM, MOST_TURNS_DEG, Array, read_only
from ctrplan.base.catalogue import Catalogue
from ctrplan.errors import InputError
from ctrplan.storage.csv_table import file_bytes, file_name
from ctrplan.storage.toml_faults import first_fault, rule_of_options, unit_of

LARGEST_NUMBER = 1e12
LARGEST_WEIGHT = 1e6
FINEST_MM = 1e-3  # finer than any solve

Name = Annotated[str, Meta(min_length=1, max_length=80)]
Length = Annotated[float, Meta(gt=0, le=LONGEST_MM)]  # mm
Distance = Annotated[float, Meta(ge=0, le=LONGEST_MM)]  # mm
Tolerance = Annotated[float, Meta(ge=FINEST_MM, le=1000)]  # mm
Angle = Annotated[float, Meta(ge=-MOST_TURNS_DEG, le=MOST_TURNS_DEG)]  # deg
Weight = Annotated[float, Meta(ge=0, le=LARGEST_WEIGHT)]  # of a term in a sum
Fraction = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1, le=100_000)]
Component = Annotated[float, Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]  # of a vector whose length does not matter
Vector = tuple[Component, Component, Component]
Coordinate = Annotated[float, Meta(ge=-LONGEST_MM, le=LONGEST_MM)]  # mm
Point = tuple[Coordinate, Coordinate, Coordinate]  # mm


def metres(point_mm: Point) -> Array:
    """(3,) [m] of a point in mm, read-only."""
    return read_only(np.multiply(point_mm, 1e-3))


ROUNDING = 1e-6  # relative, of values and ends written with a few digits


def interval_fault(ends: Any, value: float) -> str:
    """The rule that `ends` break as an interval around `value`, as the end of a sentence; empty if they don't."""
    is_pair = isinstance(ends, (list, tuple)) and len(ends) == 2
    if not is_pair or not all(isinstance(end, (int, float)) and not isinstance(end, bool) for end in ends):
        return "must be an interval [low, high] of two numbers"
    low, high = float(ends[0]), float(ends[1])
    if not (math.isfinite(low) and math.isfinite(high)):
        return "must be an interval of finite numbers"
    if low > high:
        return "must be an interval [low, high] with low <= high"
    slack = ROUNDING * max(abs(low), abs(high), abs(value))
    if not low - slack <= value <= high + slack:
        return f"must contain its value, {value:.6g}{_hint(low, high, value)}"
    return ""


def _hint(low: float, high: float, value: float) -> str:
    """How an interval may have been said that does not contain its value, as the end of a sentence."""
    if low < 0 < high:
        return ": is it said as plus or minus?"
    factors = {"1000 times too small": 1e3, "1000 times too large": 1e-3, "in %": 1e-2, "in radians": 180 / math.pi}
    readings = [words for words, factor in factors.items() if low * factor <= value <= high * factor]
    readings += ["said as a share of the value"] if low <= 1 <= high else []
    return f": is it {' or '.join(readings)}?" if readings and value else ""


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
            result = dict(_numbers(self.content))
            for path in (path for path, value in result.items() if not abs(value) <= sys.float_info.max):
                raise self.fault("must be a finite number", *path)
            entry = msgspec.convert(self.content, schema)
            for path in (path for path, value in result.items() if abs(value) > LARGEST_NUMBER):
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


def parsed_toml(text: str, file: str) -> dict[str, Any]:
    """The content of a text in TOML; `file` is what errors call it. Raises InputError."""
    return _parse(text.encode(), file)


def _parse(data: bytes, file: str) -> dict[str, Any]:
    try:
        content: dict[str, Any] = tomllib.loads(data.decode("utf-8-sig"))
        return content
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 text (byte {error.start}), as TOML files are", file=file) from None
    except tomllib.TOMLDecodeError as error:
        message, _, place = str(error).rstrip(")").partition(" (at ")
        hint = " (text needs quotes, and numbers a point for the comma)" if "value" in message.lower() else ""
        if any(said in message for said in ("overwrite", "twice", "mutate")):
            hint = " (a key is said once; a table that may be there several times has [[two brackets]] each time)"
        if "after a statement" in message:  # as what follows a decimal comma does
            hint = " (numbers have a point for the comma, and a key a line of its own)"
        hint = " (it is a table: are two files exchanged?)" if file.lower().endswith(".csv") else hint
        hint = " (it is JSON: are two files exchanged?)" if data.lstrip().startswith(b"{") else hint
        raise InputError(f"is not valid TOML at {place or 'an unknown place'}: {message}{hint}", file=file) from None
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
    """`text` as a TOML value, or .5 and 5. as numbers; other text stands for itself: a shell needs no quotes."""
    if re.fullmatch(r"[-+]?(\d+\.|\.\d+)", text, re.ASCII):
        return float(text)
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


def toml_text(content: Mapping[str, Any]) -> str:
    """The content; read back it is the same."""
    tables = {key: value for key, value in content.items() if isinstance(value, Mapping) or _is_tables(value)}
    lines = [f"{_key(key)} = {toml_value(value)}\n" for key, value in content.items() if key not in tables]
    for key, value in tables.items():
        single, many = f"\n[{_key(key)}]\n", f"\n[[{_key(key)}]]\n"
        blocks = [(single, value)] if isinstance(value, Mapping) else [(many, table) for table in value]
        lines += [head + "".join(f"{_key(k)} = {toml_value(v)}\n" for k, v in table.items()) for head, table in blocks]
    return "".join(lines)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _key(name: str) -> str:
    return tomli_w.dumps({name: 0}).partition(" = 0")[0]


def toml_value(value: Any) -> str:
    """A value as a file spells it on one line."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {toml_value(v)}" for k, v in value.items()) + "}"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")


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


def in_si(fault: InputError) -> InputError:
    """The fault of what was made in code: its quantity in metres or radians, by the name that ends so."""
    name, _, unit = (fault.key or "").rpartition("_")
    if unit not in SI_OF or fault.value is ...:
        return fault
    (si, factor), value = SI_OF[unit], fault.value
    value = [factor * x for x in value] if isinstance(value, (list, tuple)) else factor * value
    return InputError(fault.rule, file=fault.file, key=f"{name}_{si}", value=value, unit=fault.unit and si)


SI_OF = {"mm": ("m", 1e-3), "deg": ("rad", math.radians(1))}  # units that keys end with


def file_inside(name: str, document: Document, allow_outside: bool | None, *path: Step) -> Path:
    """The file that key `path` names, relative to the document's folder.

    Raises InputError when it lies outside that folder, unless allowed (None: nobody can), or does not exist.
    """
    return _inside(name, document, allow_outside, Path.is_file, *path)


def path_inside(name: str, document: Document, *path: Step) -> Path:
    """The file or folder that key `path` names, which must lie in the document's folder or below and exist."""
    return _inside(name, document, None, Path.exists, *path)


def _inside(
    name: str, document: Document, allow_outside: bool | None, is_there: Callable[[Path], bool], *path: Step
) -> Path:
    folder = Path(document.file or ".").parent
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
        exists = is_there(folder / name)
    except (OSError, ValueError, RuntimeError):  # a NUL in the name, a loop of links, a closed folder
        inside, exists = True, False
    if not (inside or allow_outside):
        unless = "" if allow_outside is None else ", unless --allow-outside is given"
        raise document.fault(f"must lie in the folder of this file or below{unless}", *path)
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
    return [name for name in schema.__struct_fields__ if name not in common.__struct_fields__]


@cache
def _required(schema: type[msgspec.Struct]) -> Sequence[str]:
    return tuple(field.name for field in msgspec.structs.fields(schema) if field.required)
