"""[uncertainty] of a robot file: 95 % intervals of the file's own numbers, and how their errors go together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from ctrplan.base.arrays import Array, read_only
from ctrplan.errors import InputError
from ctrplan.robot.named_numbers import MAGNITUDE, value_of
from ctrplan.robot.robot import KEYS, Robot, StatedIntervals
from ctrplan.storage.toml_document import Document, Step, interval_fault


class UncertaintyEntry(Struct, forbid_unknown_fields=True):
    """[uncertainty]: 95 % intervals of the file's own numbers, and how errors go together."""

    ci95: dict[str, Any] = {}
    correlated: list[str] = []
    correlation: list[list[Annotated[float, Meta(ge=-1.001, le=1.001)]]] = []  # rounded ones too


ROUNDING = 1e-3  # of correlations
PLACE = ("uncertainty", "ci95")


def build_intervals(entry: UncertaintyEntry | None, robot: Robot, document: Document) -> StatedIntervals:
    """The table in SI. Raises InputError for what is no number of the file, no interval, or no correlation."""
    if entry is None:
        return StatedIntervals()
    results: dict[str, tuple[float, float]] = {}
    for path, ends in _flat(entry.ci95):
        name, si = _named(path, robot, document)
        value = value_of(robot, name)
        if fault := interval_fault(ends, value / si):
            raise document.fault(fault, *PLACE, *path)
        if name.endswith(MAGNITUDE) and value == 0:
            raise document.fault("has no direction, the section is straight", *PLACE, *path)
        results[name] = float(ends[0]) * si, float(ends[1]) * si
    names = tuple(_correlated(name, robot, results, document) for name in entry.correlated)
    return StatedIntervals(results, names, _correlation(entry, document))


def _flat(table: Mapping[str, Any], path: tuple[Step, ...] = ()) -> Iterator[tuple[tuple[Step, ...], Any]]:
    """Keys as `tube.2.poisson_ratio`, written in quotes or as tables in tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, (*path, key))
        else:
            yield (*path, key), value


def _named(path: tuple[Step, ...], robot: Robot, document: Document) -> tuple[str, float]:
    """The number's name and the SI value of its unit in the file."""
    stem, _, key = ".".join(map(str, path)).rpartition(".")
    try:
        name, si = KEYS[key]
        value_of(robot, f"{stem}.{name}")
    except (KeyError, InputError):
        known = ", ".join(KEYS)
        rule = (
            f"is no number of this file that may have an interval, such as tube.1.poisson_ratio; those end in {known}"
        )
        raise document.fault(rule, *PLACE, *path) from None
    return f"{stem}.{name}", si


def _correlated(name: str, robot: Robot, results: Mapping[str, Any], document: Document) -> str:
    """The name, SI, if it has an interval."""
    kind, *rest = name.split(".")
    if kind == "effects" and len(rest) == 2:
        table = robot.effects.get(rest[0], {})
        if isinstance(table, dict) and rest[1] in table.get("ci95", {}):
            return name
    stem, _, key = name.rpartition(".")
    if key in KEYS and f"{stem}.{KEYS[key][0]}" in results:
        return f"{stem}.{KEYS[key][0]}"
    raise document.fault(f'"{name}" has no 95 % interval in this file', "uncertainty", "correlated")


def _correlation(entry: UncertaintyEntry, document: Document) -> Array | None:
    count = len(entry.correlated)
    if any(len(row) != count for row in entry.correlation) or len(entry.correlation) != count:
        raise document.fault(f"must be {count} rows of {count} numbers, as `correlated`", "uncertainty", "correlation")
    if len(set(entry.correlated)) != count:
        raise document.fault("names a parameter twice", "uncertainty", "correlated")
    if not count:
        return None
    result = np.array(entry.correlation)
    symmetric = np.allclose(result, result.T, rtol=0, atol=ROUNDING) and np.allclose(np.diag(result), 1, rtol=0)
    if not symmetric or np.linalg.eigvalsh((result + result.T) / 2).min() < -count * ROUNDING:
        rule = "must be a correlation: symmetric, 1 on its diagonal, no negative eigenvalue"
        raise document.fault(rule, "uncertainty", "correlation")
    return read_only((result + result.T) / 2)
