"""Rows of a study's page: along each axis, of every number, of the reasons, of the best and the worst row."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.reports.words import digits
from ctrplan.studies.study.store import PLANS
from ctrplan.studies.study.study_definition import StudyDefinition
from ctrplan.studies.study.table import FIRST, LAST, TIMING, StudyTable, extremes, judged_by


@dataclass(frozen=True)
class Quantity:
    """A number of the table."""

    column: str
    name: str
    unit: str = ""
    is_better: int = -1  # -1: less is, 1: more is, 0: neither

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


KNOWN = (
    Quantity("worst_mm", "tip to target at worst", "mm"),
    Quantity("bound_mm", "worst-case friction error", "mm"),
    Quantity("goal_bound_mm", "worst-case friction error at the goal", "mm"),
    Quantity("worst_bound_mm", "worst-case friction error on the way", "mm"),
    Quantity("goal_predicted_mm", "predicted friction error at the goal", "mm"),
    Quantity("clearance_mm", "clearance beyond margins", "mm", 1),
    Quantity("stability", "stability", "", 1),
    Quantity("max_strain", "largest strain"),
    Quantity("cost_mm", "cost", "mm"),
    Quantity("length_mm", "length of the motion", "mm"),
    Quantity("duration_s", "duration of the motion", "s"),
    Quantity("tip_error_mm", "tip to target without friction", "mm"),
    Quantity("valid", "valid configurations", "", 1),
    Quantity("nearest_mm", "nearest tip to target", "mm"),
    Quantity("largest_deviation_mm", "largest deviation by friction", "mm"),
    Quantity("largest_bound_mm", "largest worst-case friction error", "mm"),
    Quantity("after_rms_mm", "error that remains, rms", "mm"),
)
UNITS = {"mm": "mm", "deg": "deg", "s": "s"}


def inputs_of(study: StudyDefinition, table: StudyTable) -> list[str]:
    """Columns of what is varied, in the table's order."""
    names = {name for axis in study.axes for name in axis.at(0).inputs}
    return [name for name in table.columns if name in names]


def quantities(study: StudyDefinition, table: StudyTable) -> list[Quantity]:
    """Numbers of the table that are not all alike, and what rows are judged by, which is first."""
    outside = {*FIRST, *LAST, *TIMING, *inputs_of(study, table)}
    known = {quantity.column: quantity for quantity in KNOWN}
    order = [judged_by(study), *known, *table.columns]
    results = []
    for column in dict.fromkeys(name for name in order if name in table.columns and name not in outside):
        values = table[column]
        is_judged = column == judged_by(study) and values.dtype == np.float64 and bool(np.isfinite(values).any())
        if is_judged or (values.dtype == np.float64 and spread(values) > 0):
            results.append(known.get(column) or _named(column, is_flag(table, column)))
    return results


def is_flag(table: StudyTable, column: str) -> bool:
    """Whether a column says yes or no."""
    return all(value is None or isinstance(value, bool) for value in table.columns[column])


def _named(column: str, flag: bool) -> Quantity:
    """By its own name; the unit that a yes or no is about stays a part of it."""
    if flag:
        return Quantity(column, column.replace("_", " "), "", 0)
    return Quantity(column, column.rpartition("_")[0] or column, _unit(column), 0)


def spread(values: Array) -> float:
    """Between the least and the largest finite one; 0 where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if len(finite) else 0.0


def _unit(column: str) -> str:
    return UNITS.get(column.rpartition("_")[2], "")


MOST_VALUES = 24  # of an axis that has a table
MOST_REASONS = 8
_NUMBER = re.compile(r"-?\d[\d.,]*(e-?\d+)?")


def along_axes(study: StudyDefinition, rows: StudyTable, judged: Quantity | None) -> list[Any]:
    """Name, header and rows of each input with a few values: tasks, what became of them, what they are judged by."""
    results = []
    for name in inputs_of(study, rows):
        values = rows.columns[name]
        distinct = sorted(set(values), key=lambda value: (str(type(value)), value))
        if 2 <= len(distinct) <= MOST_VALUES and not name.startswith(("target_", "base_")):
            lines = [_line(rows, np.array([v == value for v in values]), value, judged) for value in distinct]
            results.append((name, _head(rows, name, judged), lines))
    return results


def _head(rows: StudyTable, name: str, judged: Quantity | None) -> list[str]:
    head = [name, "Tasks", "With an answer"]
    if "within_tolerance" in rows.columns:
        head.append("Within tolerance whatever friction does")
    return [*head, f"Median of {judged.label}", "Least", "Largest"] if judged else head


def _line(rows: StudyTable, chosen: Array, value: Any, judged: Quantity | None) -> list[str]:
    count = int(chosen.sum())
    line = [_shown(value), f"{count:,}", percent(rows.done[chosen].mean())]
    if "within_tolerance" in rows.columns:
        line.append(percent(np.nan_to_num(rows["within_tolerance"][chosen]).mean()))
    if judged:
        numbers = rows[judged.column][chosen]
        line += _summary(numbers)
    return line


def of_numbers(rows: StudyTable, shown: list[Quantity]) -> list[list[str]]:
    """Every number: how many tasks have it, median and ends."""
    lines = []
    for quantity in shown:
        values = rows[quantity.column]
        if not is_flag(rows, quantity.column):
            lines.append([quantity.label, f"{np.isfinite(values).sum():,}", *_summary(values)])
    return lines


def of_flags(rows: StudyTable, shown: list[Quantity]) -> list[list[str]]:
    """What is a yes or no: how many tasks say it, in how many it is a yes, their share."""
    lines = []
    for quantity in shown:
        values = rows[quantity.column]
        if is_flag(rows, quantity.column):
            yes, known = int((values == 1).sum()), int(np.isfinite(values).sum())
            lines.append([quantity.label, f"{known:,}", f"{yes:,}", percent(yes / known)])
    return lines


def _summary(values: Array) -> list[str]:
    known = values[np.isfinite(values)]
    if not len(known):
        return ["-", "-", "-"]
    return [digits(float(pick(known))) for pick in (np.median, np.min, np.max)]


def of_reasons(rows: StudyTable) -> list[list[str]]:
    """Why tasks have no answer, those that differ in numbers alone counted together, each with one of its sentences."""
    sentences: dict[tuple[str, str], list[str]] = {}
    for status, reason in zip(rows.columns["status"], rows.columns["reason"], strict=True):
        if status != "done":
            sentences.setdefault((status, _NUMBER.sub("#", reason)), []).append(reason)
    most = Counter({key: len(reasons) for key, reasons in sentences.items()}).most_common(MOST_REASONS)
    return [[f"{count:,}", key[0], sentences[key][0]] for key, count in most]


def of_extremes(study: StudyDefinition, rows: StudyTable, judged: Quantity) -> list[dict[str, Any]]:
    """Best and worst row: inputs, files of the plan with their addresses, and the command that repeats it."""
    every, cases = list(rows.rows()), []
    for which, k in zip(("Best", "Worst"), extremes(every, judged.column), strict=False):
        row, place = every[k], Path(PLANS) / f"{every[k]['index']:06d}"
        inputs = [(name, _shown(row[name])) for name in inputs_of(study, rows) if row.get(name) is not None]
        kept = (rows.folder or Path()) / place
        names = [name for name in ("report.html", "plan.png", "plan.json") if (kept / name).is_file()]
        files = [(name, (place / name).as_posix()) for name in names]
        label = f"{which}: {digits(row[judged.column])} {judged.unit}".rstrip()
        cases.append({"label": label, "inputs": inputs, "files": files, "command": _command(study, row)})
    return cases


def _command(study: StudyDefinition, row: dict[str, Any]) -> str:
    """The command line that does the same as a plan's row."""
    import json

    if study.kind.kind != "plan" or study.entry.scenario is None:
        return ""
    overrides = [f"--set {shlex.quote(text)}" for text in json.loads(row["set"])]
    seed = row.get("seed", study.entry.seed)
    return " ".join(["ctrplan plan", shlex.quote(study.entry.scenario), f"--seed {seed}", *overrides])


def percent(share: float) -> str:
    """A share for people."""
    return f"{100 * share:.0f} %" if share in (0, 1) or 0.1 <= share <= 0.9 else f"{100 * share:.1f} %"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
