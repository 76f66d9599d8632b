"""Design files (TOML): read strictly; `studies/design/definition.py` makes a search of what stands in them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from ctrplan.files.design_entries import DesignEntry
from ctrplan.files.study_file import check_targets
from ctrplan.storage.toml_document import Document, read_document


def read_design(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> tuple[DesignEntry, Document]:
    """The entries of a design file after `overrides`, and its content.

    Raises InputError, one sentence with file, key, value and rule, for anything malformed or contradictory.
    """
    document = read_document(path, overrides)
    return checked_design(document), document


def checked_design(document: Document) -> DesignEntry:
    """The content of a design file as entries. Raises InputError."""
    entry = document.to(DesignEntry)
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    if not entry.parameter and not entry.stock:
        raise document.fault("is missing, or [[stock]]: nothing may be chosen", "parameter")
    check_targets(entry.targets, document)
    if entry.targets.direction is not None:
        raise document.fault("does not go with a design, whose targets are points", "targets", "direction")
    for k in range(len(entry.parameter)):
        _check_parameter(entry, document, k)
    for k, stock in enumerate(entry.stock):
        if not stock.inner_diameter_mm < stock.outer_diameter_mm:
            rule = f"must be below outer_diameter_mm = {stock.outer_diameter_mm:g}"
            raise document.fault(rule, "stock", k, "inner_diameter_mm")
        if any(other.name == stock.name for other in entry.stock[:k]):
            raise document.fault("is there twice", "stock", k, "name")
    if not all(_is_plain(value) for value in entry.set.values()):
        raise document.fault("must be numbers, texts, truth values, lists or tables", "set")
    if len(set(entry.objectives)) < len(entry.objectives):
        raise document.fault("names one twice", "objectives")
    if "robust_mm" in entry.objectives and not has_tolerances(entry):
        raise document.fault("has robust_mm, but nothing has a tolerance", "objectives")
    return entry


def has_tolerances(entry: DesignEntry) -> bool:
    """Whether anything may come out otherwise than designed."""
    of_stock = any(stock.diameter_tolerance_mm or stock.stiffness_tolerance_percent for stock in entry.stock)
    return of_stock or any(parameter.tolerance or parameter.tolerance_percent for parameter in entry.parameter)


def _is_plain(value: Any) -> bool:
    """Whether --set can be told a value."""
    if isinstance(value, dict):
        return all(map(_is_plain, value.values()))
    return all(map(_is_plain, value)) if isinstance(value, list) else isinstance(value, (str, int, float, bool))


def _check_parameter(entry: DesignEntry, document: Document, k: int) -> None:
    """Raises InputError unless one [[parameter]] says one thing."""
    parameter = entry.parameter[k]
    if not parameter.low < parameter.high:
        raise document.fault(f"must be below high = {parameter.high:g}", "parameter", k, "low")
    if parameter.step is not None and parameter.step > parameter.high - parameter.low:
        raise document.fault("is wider than from low to high", "parameter", k, "step")
    if parameter.tolerance and parameter.tolerance_percent:
        raise document.fault("does not go with tolerance", "parameter", k, "tolerance_percent")
    for other in entry.parameter[:k]:
        if parameter.key == other.key or (parameter.name or parameter.key) == (other.name or other.key):
            raise document.fault("is there twice", "parameter", k, "key" if parameter.key == other.key else "name")
