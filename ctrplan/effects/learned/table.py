"""[effects.learned_NAME] of a robot file: the effect that it is, and what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from ctrplan.effects.learned import parts
from ctrplan.effects.learned.learned import Learned, learned, ranges_of, split_name
from ctrplan.effects.learned.targets import PREFIX, target

TEXTS = ("stage", "acts_on", "formula", "may_be")  # for people; nothing reads them
NOTES = (*TEXTS, "largest_mm", "range")  # keys that are no coefficients
MOST_PARTS = 48  # coefficients of one term


def is_learned(name: str) -> bool:
    """Whether an effect of that name was built."""
    return name.startswith(PREFIX)


def learned_in(name: str, table: Mapping[str, Any], notes: tuple[str, ...], n: int) -> Learned:
    """The effect of a table that `faults` finds nothing in, of a robot of n tubes; `notes` are keys of any effect."""
    on = target(name, n)
    assert on is not None
    names = [key for key in table if key not in (*notes, *NOTES)]
    return learned(on, names, ranges_of(table), n, float(table.get("largest_mm", 0.0)))


def faults(name: str, table: Mapping[str, Any], notes: tuple[str, ...], n: int) -> Iterator[tuple[str, str]]:
    """Keys, empty for the whole table, with what is wrong with each."""
    on = target(name, n)
    if on is None:
        rule = "is no term of this robot: learned_theta_I, l_I, curvature_I, bend_I, stiffness_I, plate or sensor"
        yield "", rule
        return
    asked: set[str] = set()
    coefficients = [key for key in table if key not in (*notes, *NOTES)]
    for key in coefficients:
        found = split_name(key, on, n)
        if found is None:
            axis = "AXIS_" if on.kind.has_axes else ""
            yield key, f"is no part of a built term, which are named {axis}PART_{on.kind.unit}: docs/effects.md"
        else:
            asked |= set(parts.inputs(found[1]))
    if len(coefficients) > MOST_PARTS:
        yield "", f"has {len(coefficients)} coefficients, more than {MOST_PARTS}"
    for key in TEXTS:
        if not isinstance(table.get(key, ""), str):
            yield key, "must be a text"
    if on.kind.stage == "mechanics" and not (
        _is_number(table.get("largest_mm", 0.0)) and table.get("largest_mm", 0) >= 0
    ):
        yield "largest_mm", "must be a number of at least 0"
    yield from _range_faults(table.get("range", {}), asked)


def _range_faults(ranges: Any, asked: set[str]) -> Iterator[tuple[str, str]]:
    if not isinstance(ranges, dict):
        yield "range", "must be a table of ranges, input = [lowest, highest]"
        return
    for name in sorted(asked):
        ends = ranges.get(name)
        if not (isinstance(ends, list) and len(ends) == 2 and all(map(_is_number, ends)) and ends[0] <= ends[1]):
            yield "range", f"must have {name} = [lowest, highest], which a part depends on"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
