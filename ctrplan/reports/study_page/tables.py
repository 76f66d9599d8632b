"""Tables of a study's page: along each axis, of every number, of the reasons, of the best and the worst row."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.reports.html_page import Markup, escaped, facts, table, tag
from ctrplan.reports.plan_words.numbers import digits
from ctrplan.reports.study_page.quantities import Quantity, inputs_of, is_flag
from ctrplan.studies.study.definition import Definition
from ctrplan.studies.study.extremes import extremes
from ctrplan.studies.study.store import PLANS
from ctrplan.studies.study.table import StudyTable

MOST_VALUES = 24  # of an axis that has a table
MOST_REASONS = 8
_NUMBER = re.compile(r"-?\d[\d.,]*(e-?\d+)?")


def along_axes(study: Definition, rows: StudyTable, judged: Quantity | None) -> list[tuple[str, Markup]]:
    """For each input with a few values: its tasks, what became of them, and what they are judged by."""
    found = []
    for name in inputs_of(study, rows):
        values = rows.columns[name]
        distinct = sorted(set(values), key=lambda value: (str(type(value)), value))
        if 2 <= len(distinct) <= MOST_VALUES and not name.startswith(("target_", "base_")):
            lines = [_line(rows, np.array([v == value for v in values]), value, judged) for value in distinct]
            found.append((name, table(_head(rows, name, judged), lines)))
    return found


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


def of_numbers(rows: StudyTable, shown: list[Quantity]) -> Markup:
    """Median and ends of every number."""
    lines = []
    for quantity in shown:
        values = rows[quantity.column]
        if not is_flag(rows, quantity.column):
            lines.append([quantity.label, f"{np.isfinite(values).sum():,}", *_summary(values)])
    return table(["", "Tasks that have it", "Median", "Least", "Largest"], lines)


def of_flags(rows: StudyTable, shown: list[Quantity]) -> Markup:
    """In how many tasks what is a yes or no is a yes; nothing where there is none."""
    lines = []
    for quantity in shown:
        values = rows[quantity.column]
        if is_flag(rows, quantity.column):
            yes, known = int((values == 1).sum()), int(np.isfinite(values).sum())
            lines.append([quantity.label, f"{known:,}", f"{yes:,}", percent(yes / known)])
    return table(["", "Tasks that say it", "Yes", "Share"], lines) if lines else Markup("")


def _summary(values: Array) -> list[str]:
    known = values[np.isfinite(values)]
    if not len(known):
        return ["-", "-", "-"]
    return [digits(float(pick(known))) for pick in (np.median, np.min, np.max)]


def of_reasons(rows: StudyTable) -> Markup:
    """Why tasks have no answer, those that differ in numbers alone counted together, each with one of its sentences."""
    sentences: dict[tuple[str, str], list[str]] = {}
    for status, reason in zip(rows.columns["status"], rows.columns["reason"], strict=True):
        if status != "done":
            sentences.setdefault((status, _NUMBER.sub("#", reason)), []).append(reason)
    most = Counter({key: len(said) for key, said in sentences.items()}).most_common(MOST_REASONS)
    lines = [[f"{count:,}", key[0], sentences[key][0]] for key, count in most]
    return table(["Tasks", "", "For example"], lines)


def of_extremes(study: Definition, rows: StudyTable, judged: Quantity) -> Markup:
    """The best and the worst row, with their plans."""
    every = list(rows.rows())
    found = extremes(every, judged.column)
    parts = []
    for label, k in zip(("Best", "Worst"), found, strict=False):
        parts += [
            tag("h3", f"{label}: {digits(every[k][judged.column])} {judged.unit}".rstrip()),
            _case(study, rows, every[k]),
        ]
    return Markup("".join(parts))


def _case(study: Definition, rows: StudyTable, row: dict[str, Any]) -> Markup:
    pairs = [(name, _shown(row[name])) for name in inputs_of(study, rows) if row.get(name) is not None]
    place = Path(PLANS) / f"{row['index']:06d}"
    kept = (rows.folder or Path()) / place
    names = [name for name in ("report.html", "plan.png", "plan.json") if (kept / name).is_file()]
    if names:
        links = ", ".join(f'<a href="{escaped((place / name).as_posix())}">{escaped(name)}</a>' for name in names)
        pairs.append(("plan", Markup(links)))
    if command := _command(study, row):
        pairs.append(("again", tag("code", command)))
    return facts(pairs)


def _command(study: Definition, row: dict[str, Any]) -> str:
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
