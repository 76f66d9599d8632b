"""Which rows of a study are its best and its worst."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.studies.study.definition import Definition
    from ctrplan.studies.study.store import Store
    from ctrplan.studies.study.task import Task


def judged_by(study: Definition) -> str:
    """The column by which rows are better or worse; less is better."""
    return study.entry.keep.by or study.kind.best


def extremes(rows: Sequence[dict[str, Any]], column: str) -> list[int]:
    """Positions of the best and the worst of rows that have a number in a column; fewer where there are fewer."""
    found = [
        (row[column], k)
        for k, row in enumerate(rows)
        if isinstance(row.get(column), (int, float)) and row[column] == row[column]
    ]
    return [] if not found else list(dict.fromkeys([min(found)[1], max(found)[1]]))


def extreme_tasks(study: Definition, tasks: Sequence[Task], store: Store, files: Sequence[str]) -> list[Task]:
    """Those of the best and the worst row whose plans are not there yet. Raises InputError for an unknown column."""
    column = judged_by(study)
    done = [task for task in tasks if (key := bytes.fromhex(task.key)) in store.offsets and key not in store.failed]
    rows = [_numbers(store, task) for task in done]
    if rows and not any(column in row for row in rows):
        rule = f"is no number of this study, there are {', '.join(rows[0])}"
        raise InputError(rule, file=study.document.file, key="keep.by", value=column)
    return [
        done[k]
        for k in extremes(rows, column)
        if not all((store.plan_folder(done[k].index) / name).is_file() for name in files)
    ]


def _numbers(store: Store, task: Task) -> dict[str, Any]:
    with open(store.folder / "rows.jsonl", "rb") as file:
        file.seek(store.offsets[bytes.fromhex(task.key)])
        numbers: dict[str, Any] = json.loads(file.readline())["numbers"]
        return numbers
