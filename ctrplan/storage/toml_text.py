"""TOML as a person would write it: values on one line, a block for each table of a list."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomli_w


def toml_text(content: Mapping[str, Any]) -> str:
    """The content; read back it is the same."""
    tables = {key: value for key, value in content.items() if isinstance(value, Mapping) or _is_tables(value)}
    lines = [f"{_key(key)} = {_value(value)}\n" for key, value in content.items() if key not in tables]
    for key, value in tables.items():
        one, many = f"\n[{_key(key)}]\n", f"\n[[{_key(key)}]]\n"
        blocks = [(one, value)] if isinstance(value, Mapping) else [(many, table) for table in value]
        lines += [head + "".join(f"{_key(k)} = {_value(v)}\n" for k, v in table.items()) for head, table in blocks]
    return "".join(lines)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _key(name: str) -> str:
    return tomli_w.dumps({name: 0}).partition(" = 0")[0]


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")
