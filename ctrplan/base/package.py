"""What the package says of itself: its version, names that are imported on first use, and how its objects show."""

from __future__ import annotations

import html
import importlib
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from ctrplan.errors import FEW, InputError

__version__ = "0.1.0"


def lazy_names(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a package: `homes` gives the module of each name, without "ctrplan." before it, and
    after a colon the name there where it is another one.

    Modules of the package are imported on first use as well. Raises AttributeError for any other name.
    """

    def get(name: str) -> Any:
        if name not in homes:
            if not name.startswith("_") and find_spec(f"{package}.{name}") is not None:
                return importlib.import_module(f"{package}.{name}")
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, _, own = homes[name].partition(":")
        value = getattr(importlib.import_module(f"ctrplan.{home}"), own or name)
        setattr(sys.modules[package], name, value)
        return value

    return get


def homes_in(file: str) -> dict[str, str]:
    """Homes for `lazy_names`: of every name that a package's file imports from modules `if TYPE_CHECKING`.

    Type checkers and whoever asks for a name at run time read one list, an import a line.
    """
    homes, source = {}, Path(file).read_text(encoding="utf-8")
    for home, names in re.findall(r"^    from ctrplan\.(\S+) import (.+)$", source, re.M):
        for own, _, name in (each.partition(" as ") for each in names.split(", ")):
            homes[name or own] = f"{home}:{own}"
    return homes


T = TypeVar("T", bound=type)


def of_this_process(instead: str) -> Callable[[Any], tuple[Any, ...]]:
    """The `__reduce__` of a class whose objects hold compiled solutions: InputError that says what to do instead."""

    def refuse(self: Any) -> tuple[Any, ...]:
        raise InputError(f"a {type(self).__name__} stays in its process and is not pickled: {instead}")

    return refuse


MOST_LINES, WIDEST = 30, 110  # of what an object shows of itself


def shown(cls: T) -> T:
    """A class that shows itself in at most MOST_LINES: the fields of a dataclass by sizes and ranges, and a headline.

    The headline is what its method `headline` returns, or else its property `sentence`. Notebooks show it as a table.
    """
    cls.__repr__ = _text  # type: ignore[assignment]
    cls._repr_html_ = _table  # type: ignore[attr-defined]
    return cls


def _text(given: Any) -> str:
    rows = _rows(given)
    width = max((len(name) for name, _ in rows), default=0)
    lines = [_cut(f"{type(given).__name__}{_headline(given)}"), *(_cut(f"  {n:{width}}  {s}") for n, s in rows)]
    return "\n".join(lines)


def _table(given: Any) -> str:
    cells = "".join(
        f'<tr><th style="text-align:left">{html.escape(n)}</th><td style="text-align:left">{html.escape(s)}</td></tr>'
        for n, s in _rows(given)
    )
    return f"<b>{html.escape(type(given).__name__ + _headline(given))}</b><table>{cells}</table>"


def _headline(given: Any) -> str:
    try:
        own = callable(getattr(type(given), "headline", None))
        sentence = given.headline() if own else getattr(given, "sentence", "")
    except Exception:  # of an object that is half made: a debugger shows it all the same
        sentence = ""
    return f": {sentence}" if isinstance(sentence, str) and sentence else ""


def _rows(given: Any) -> list[tuple[str, str]]:
    """Names and values of the fields that are shown, as many as there is room for."""
    rows = []
    for each in fields(given) if is_dataclass(given) else ():
        if each.repr and not each.name.startswith("_"):
            try:
                rows.append((each.name, summary(getattr(given, each.name))))
            except Exception:  # likewise
                rows.append((each.name, "?"))
    most = MOST_LINES - 1
    return rows if len(rows) <= most else [*rows[: most - 1], ("...", f"{len(rows) - most + 1} more")]


def summary(value: Any) -> str:
    """A value in one line: numbers as they are, arrays by shape and range, objects by their headline or type."""
    if isinstance(value, Enum):
        return value.name
    if value is None or isinstance(value, (bool, int)):
        return repr(value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str):
        return _cut(repr(value), 80)
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return _array(value)
    if isinstance(value, Mapping):
        return f"{len(value)} by name: {_cut(', '.join(map(str, value)), 80)}" if value else "{}"
    if isinstance(value, (tuple, list)):
        return _sequence(value)
    if is_dataclass(value):
        return _cut(f"{type(value).__name__}{_headline(value)}", 90)
    return f"a {type(value).__name__}"


def _array(values: Any) -> str:
    if values.size <= FEW and values.ndim <= 1:
        return "[" + ", ".join(f"{x:.6g}" if isinstance(x, float) else str(x) for x in values.ravel().tolist()) + "]"
    size = " x ".join(map(str, values.shape))
    if values.dtype.kind not in "fiu":
        return f"{size} {values.dtype.name}"
    try:
        finite = values[abs(values) < float("inf")]  # leaves NaN out, too
        return f"{size}, {finite.min():.4g} to {finite.max():.4g}"
    except (TypeError, ValueError):
        return size


def _sequence(values: Any) -> str:
    simple = all(isinstance(x, (str, int, float)) or x is None for x in values)
    if len(values) <= FEW and simple:
        return "(" + ", ".join(summary(x) for x in values) + ")"
    if not values:
        return "()"
    kinds = sorted({type(x).__name__ for x in values})
    return f"{len(values)} of {', '.join(kinds)}"


def _cut(text: str, most: int = WIDEST) -> str:
    line = " ".join(text.splitlines())
    return line if len(line) <= most else line[: most - 3] + "..."


def counted(count: int, thing: str) -> str:
    """So many of a thing, "1 leg" or "2 entries"."""
    several = f"{thing.removesuffix('y')}ies" if thing.endswith("y") else f"{thing}s"
    return f"{count} {thing if count == 1 else several}"


def warn_caller(text: str) -> None:
    """Warns whoever called this package, at the line that did; commands warn in words of their own."""
    level, frame = 1, sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] in ("ctrplan", "dataclasses"):
        if frame.f_globals["__name__"].startswith("ctrplan.commands."):
            return
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)
