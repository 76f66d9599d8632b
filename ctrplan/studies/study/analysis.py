"""What the table of a study shows: its best and worst rows, and how much of a spread each drawn parameter makes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.studies.study.axes import LEVELS, DrawAxis, check_salib, distributed, problem
from ctrplan.studies.study.study_definition import StudyDefinition
from ctrplan.studies.study.table import StudyTable

if TYPE_CHECKING:
    from ctrplan.studies.study.store import Store
    from ctrplan.studies.study.task import Task


def judged_by(study: StudyDefinition) -> str:
    """The column by which rows are better or worse; less is better."""
    return study.entry.keep.by or study.kind.best


def extremes(rows: Sequence[dict[str, Any]], column: str) -> list[int]:
    """Positions of the best and the worst of rows that have a number in a column; fewer where there are fewer."""
    results = [
        (row[column], k)
        for k, row in enumerate(rows)
        if isinstance(row.get(column), (int, float)) and row[column] == row[column]
    ]
    return [] if not results else list(dict.fromkeys([min(results)[1], max(results)[1]]))


def extreme_tasks(study: StudyDefinition, tasks: Sequence[Task], store: Store, files: Sequence[str]) -> list[Task]:
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


FEWEST = 4  # base samples or trajectories
LEVEL = 0.95  # of the intervals


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sensitivities of one column of a study's table to D keys; NaN where the column does not vary.

    Sobol': `first` is the share of the variance that a key makes alone, `total` with all others. Morris: `total` is the
    mean size of elementary effects (mu*), `first` their standard deviation, in the column's unit.
    """

    method: str
    keys: tuple[str, ...]
    first: Array  # (D,)
    total: Array  # (D,)
    total_interval: Array  # (D,) half of the 95 % interval of `total`
    used: int  # base samples or trajectories all of whose tasks have a number
    count: int  # and how many there are


def sensitivity(study: StudyDefinition, table: StudyTable, column: str) -> Sensitivity | None:
    """The indices of a column, a mean over all else that is varied; None where nothing was drawn for them.

    A base sample or trajectory one of whose tasks has no number is left out. Raises InputError without SALib.
    """
    method = study.entry.draws.method
    at = next((k for k, axis in enumerate(study.axes) if isinstance(axis, DrawAxis)), None)
    if at is None or method == "random" or len(table) < study.count:
        return None
    check_salib(method)
    axis = study.axes[at]
    assert isinstance(axis, DrawAxis)
    shape = [len(other) for other in study.axes]
    values = np.moveaxis(table[column][: study.count].reshape(shape), at, 0).reshape(len(axis), -1)
    mean = values.mean(axis=1)  # NaN where any is
    keys = tuple(vary.key for vary in distributed(study.entry))
    size = len(keys) + (2 if method == "sobol" else 1)
    blocks = np.isfinite(mean).reshape(-1, size).all(axis=1)
    rows = np.repeat(blocks, size)
    if blocks.sum() < FEWEST or np.ptp(mean[rows]) == 0:
        nothing = np.full(len(keys), np.nan)
        return Sensitivity(method, keys, nothing, nothing, nothing, int(blocks.sum()), len(blocks))
    first, total, interval = _analysed(study, method, axis.rows[rows], mean[rows])
    return Sensitivity(method, keys, first, total, interval, int(blocks.sum()), len(blocks))


def _analysed(study: StudyDefinition, method: str, x: Array, y: Array) -> tuple[Array, Array, Array]:
    asked = problem(distributed(study.entry))
    if method == "sobol":
        from SALib.analyze import sobol

        result = sobol.analyze(asked, y, calc_second_order=False, conf_level=LEVEL, seed=0)
        return np.asarray(result["S1"]), np.asarray(result["ST"]), np.asarray(result["ST_conf"])
    from SALib.analyze import morris

    result = morris.analyze(asked, x, y, num_levels=LEVELS, conf_level=LEVEL, seed=0)
    return np.asarray(result["sigma"]), np.asarray(result["mu_star"]), np.asarray(result["mu_star_conf"])
