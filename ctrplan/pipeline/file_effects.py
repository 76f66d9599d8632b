"""[effects.*] of a robot file, read strictly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ctrplan.effects.effect import CATALOGUE, Parameter
from ctrplan.effects.learned import table as learned_table
from ctrplan.effects.of_file import COMMON_NOTES, NOTES, effect_of
from ctrplan.robot.robot import Robot
from ctrplan.storage.interval import interval_fault
from ctrplan.storage.toml_document import Document


def check_effects(robot: Robot, document: Document) -> None:
    """Raises InputError for an effect that is not in the catalogue and for parameters it does not have."""
    for name, table in robot.effects.items():
        if learned_table.is_learned(name):
            for key, rule in learned_table.faults(name, table, COMMON_NOTES, robot.n):
                raise document.fault(rule, "effects", name, *([key] if key else []))
        elif name not in CATALOGUE:
            raise document.fault(f"unknown effect, known ones are {', '.join(CATALOGUE)}", "effects", name)
        known = {parameter.name: parameter for parameter in effect_of(name, table, robot.n).parameters(robot)}
        for key, value in table.items():
            if key in (NOTES if learned_table.is_learned(name) else COMMON_NOTES):
                continue
            if key not in known:
                raise document.fault(f"unknown parameter, known ones are {', '.join(known)}", "effects", name, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise document.fault("must be a number", "effects", name, key)
            low, high = known[key].lower, known[key].upper
            if not low <= value <= high:
                raise document.fault(f"must be from {low:g} to {high:g}", "effects", name, key)
        _check_intervals(name, table, known, document)


def _check_intervals(name: str, table: Mapping[str, Any], known: Mapping[str, Parameter], document: Document) -> None:
    intervals = table.get("ci95", {})
    if not isinstance(intervals, dict):
        raise document.fault("must be a table of intervals", "effects", name, "ci95")
    for key, ends in intervals.items():
        if key not in known:
            raise document.fault(f"unknown parameter, known ones are {', '.join(known)}", "effects", name, "ci95", key)
        if fault := interval_fault(ends, float(table.get(key, known[key].neutral))):
            raise document.fault(fault, "effects", name, "ci95", key)
        if not (known[key].lower <= ends[0] and ends[1] <= known[key].upper):
            rule = f"must be from {known[key].lower:g} to {known[key].upper:g}"
            raise document.fault(rule, "effects", name, "ci95", key)
