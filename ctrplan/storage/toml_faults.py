"""What is wrong with a TOML document that does not fit its schema, said in the words of the file."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

import msgspec

# suffix of a key -> unit as people write it
UNITS = {
    "_deg_s3": "deg/s^3",
    "_deg_s2": "deg/s^2",
    "_deg_s": "deg/s",
    "_mm_s3": "mm/s^3",
    "_mm_s2": "mm/s^2",
    "_mm_s": "mm/s",
    "_kg_m3": "kg/m^3",
    "_Nm2": "N m^2",
    "_per_m": "1/m",
    "_deg": "deg",
    "_mm": "mm",
    "_s": "s",
    "_per_rad": "mm/rad",  # mm_per_rad
}
_ANY_UNIT = re.compile(
    r"_(?:per_)?(?:[µumnck]?m|in|inch|deg|degrees?|rad|rads|N?[munck]?m2|GPa|MPa|Pa|k?g_c?m3|m?s|min|percent|turns?)"
    r"(?:_s[23]?|_ms)?$"
)
# Keys that files of one kind have and those of the other do not.
_OF_ROBOTS = {"tube", "contact", "joint", "home", "measurement", "effects"}
_OF_SCENARIOS = {"robot", "start", "goal", "target", "base", "anatomy", "margins", "cost", "planner"}
_TYPES = {"float": "a number", "array": "a list", "object": "a table", "str": "text", "bool": "true or false"}


def unit_of(key: str) -> str | None:
    """The unit that the last part of a key names, as people write it."""
    suffix = _ANY_UNIT.search(key)
    return UNITS.get(suffix[0]) if suffix else None


def explain(message: str, content: dict[str, Any], schema: type[msgspec.Struct]) -> tuple[tuple[str | int, ...], str]:
    """Path (positions from 0) and rule behind msgspec's `message` about `content` not fitting `schema`."""
    match = re.fullmatch(r"(.*?)(?: - at (?:`key` in )?`\$(.*)`)?", message, re.DOTALL)
    text, place = match.groups(default="") if match else (message, "")
    path = tuple(int(i) if i else name for name, i in re.findall(r"\.([^.\[\]]+)|\[(\d+)\]", place))
    if missing := re.fullmatch("Object missing required field `(.*)`", text, re.DOTALL):
        return (*path, missing[1]), "is missing"
    if unknown := re.fullmatch("Object contains unknown field `(.*)`", text, re.DOTALL):
        return (*path, unknown[1]), _unknown_key(unknown[1], _fields_at(schema, path))
    if path and isinstance(path[-1], str) and (options := _literals(_fields_at(schema, path[:-1])[path[-1]])):
        return path, f"must be one of {', '.join(options)}"
    return path, _broken_rule(text)


def _broken_rule(text: str) -> str:
    match = re.fullmatch(r"Expected `(.*?)`(?: of (length .*?)| ([<>]=? ?\S+))?(?:, got .*)?", text, re.DOTALL)
    if not match:
        return text[:1].lower() + text[1:]
    types, length, limit = match.groups()
    if limit:
        return f"must be {limit.removesuffix('.0')}"
    kinds = " or ".join(_TYPES.get(kind, kind) for kind in types.split(" | ") if kind != "null")
    return f"must be {kinds}{f' of {length}' if length else ''}"


def _unknown_key(key: str, known: dict[str, Any]) -> str:
    if key in _OF_ROBOTS and known.keys() >= _OF_SCENARIOS:
        return f"is a key of robot files, this must be a scenario; to change its robot, write robot.{key} after --set"
    if key in _OF_SCENARIOS and "tube" in known:
        return "is a key of scenarios, this must be a robot file"
    quantity = _ANY_UNIT.sub("", key)
    if same := [name for name in known if _ANY_UNIT.sub("", name) == quantity]:
        return "unknown key, expected " + " or ".join(f"{n} (in {unit_of(n)})" if unit_of(n) else n for n in same)
    if close := difflib.get_close_matches(key, known, n=1):
        return f"unknown key, did you mean {close[0]}?"
    return f"unknown key, known ones are {', '.join(known)}"


def _fields_at(schema: type[msgspec.Struct], path: tuple[str | int, ...]) -> dict[str, Any]:
    """Keys and types of the table at `path`."""
    fields = {field.name: field.type for field in msgspec.structs.fields(schema)}
    for name in path:
        if isinstance(name, str):
            inner = next(_structs(fields[name]))
            fields = {field.name: field.type for field in msgspec.structs.fields(inner)}
    return fields


def _structs(hint: Any) -> Iterator[type[msgspec.Struct]]:
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        yield hint
    for inner in get_args(hint):
        yield from _structs(inner)


def _literals(hint: Any) -> list[str]:
    if get_origin(hint) is Literal:
        return [str(option) for option in get_args(hint)]
    return [option for inner in get_args(hint) for option in _literals(inner)]
