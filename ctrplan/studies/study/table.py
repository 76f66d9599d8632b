"""The table of a study: one row a task, columns of numbers and texts; Parquet, or CSV without pyarrow."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import LEVEL, Array
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.studies.study.axes import EXTRA, LEVELS, DrawAxis, check_salib, distributed, problem
from ctrplan.studies.study.store import CSV, PARQUET, ROWS, Store
from ctrplan.studies.study.study_definition import StudyDefinition

if TYPE_CHECKING:
    from ctrplan.studies.study.store import Store
    from ctrplan.studies.study.task import Task

BATCH = 10_000  # rows at a time
FIRST, LAST = ("index", "status", "reason"), ("set", "version", "key")
TIMING = ("seconds", "elapsed_s", "worker")  # where and how fast: no results, they differ from run to run
Columns = dict[str, type]


@shown
@dataclass(frozen=True, eq=False)
class StudyTable:
    """Rows of a study as columns, in the order of its tasks. None stands where a task has no such value."""

    columns: Mapping[str, list[Any]]
    folder: Path | None = None

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.columns["index"])

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column, (K,): numbers with NaN, or objects. Raises InputError for one that there is not."""
        if name not in self.columns:
            raise InputError(f"is no column, there are {', '.join(self.columns)}", key="column", value=name)
        values = self.columns[name]
        if all(value is None or isinstance(value, (int, float)) for value in values):
            return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
        return np.array(values, dtype=object)

    def headline(self) -> str:
        """How many rows and answers, as it shows itself."""
        return f"{len(self)} tasks, {int(self.done.sum())} with an answer"

    def show(self, height: int = 700) -> Any:
        """The report beside the table as a page within a notebook. Raises InputError where there is none."""
        import ctrplan  # pages are of a package above, and stand in the public names

        return ctrplan.show(self, height=height)

    @property
    def done(self) -> NDArray[np.bool_]:
        """(K,) which tasks have an answer."""
        return np.array([status == "done" for status in self.columns["status"]], dtype=bool)

    @property
    def results(self) -> dict[str, list[Any]]:
        """All columns but those of time and place: the same for the same study, wherever it runs."""
        return {name: values for name, values in self.columns.items() if name not in TIMING}

    def rows(self) -> Iterator[dict[str, Any]]:
        """Row by row."""
        names = list(self.columns)
        for values in zip(*self.columns.values(), strict=True):
            yield dict(zip(names, values, strict=True))

    def to_arrow(self) -> Any:
        """A pyarrow.Table. Raises InputError without pyarrow."""
        if find_spec("pyarrow") is None:
            raise InputError(f"is not installed: {EXTRA}", key="pyarrow")
        import pyarrow

        return pyarrow.table(dict(self.columns))

    def to_pandas(self) -> Any:
        """A pandas.DataFrame. Raises InputError without pandas."""
        if find_spec("pandas") is None:
            raise InputError("is not installed: pip install pandas", key="pandas")
        import pandas

        return pandas.DataFrame(dict(self.columns))

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """What polars, DuckDB and others read tables by."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)


def load_study(folder: str | os.PathLike[str]) -> StudyTable:
    """The table in a study's folder, as far as it is, also while the study runs. Raises InputError."""
    store = Store(folder)
    if not (store.folder / ROWS).is_file() or store.definition() is None:
        raise InputError("is not the folder of a study", key="folder", value=str(folder))
    store.find_rows()
    names = columns_of(store.rows())
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for row in store.rows():
        flat = flat_row(row)
        for name, kind in names.items():
            columns[name].append(_as(kind, flat.get(name)))
    return StudyTable(columns, store.folder)


def write_table(store: Store) -> Path:
    """Writes the rows that there are, whole or not at all, as Parquet or else as CSV. Returns the file."""
    names = columns_of(store.rows())
    name = PARQUET if find_spec("pyarrow") is not None else CSV
    write = _write_parquet if name == PARQUET else _write_csv
    made = store.folder / f".{name}.tmp"
    with store.writing(name):
        write(made, names, store.rows())
        os.replace(made, store.folder / name)
    return store.folder / name


def flat_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of the store as columns."""
    flat = {name: row[name] for name in (*FIRST, "version", "key", *TIMING)}
    return {**flat, **row["inputs"], **row["numbers"], "set": json.dumps(row["overrides"], ensure_ascii=False)}


def columns_of(rows: Iterable[Mapping[str, Any]]) -> Columns:
    """Names of all columns in a lasting order, and what each holds: bool, int, float or str."""
    inputs: Columns = {}
    numbers: Columns = {}
    for row in rows:
        for kinds, values in ((inputs, row["inputs"]), (numbers, row["numbers"])):
            for name, value in values.items():
                kinds[name] = _common(kinds.get(name), value)
    fixed: Columns = {"index": int, **dict.fromkeys(("status", "reason", *LAST, "worker"), str)}
    fixed |= dict.fromkeys(("seconds", "elapsed_s"), float)
    order = [*FIRST, *inputs, *sorted(numbers), *LAST, *TIMING]
    return {name: fixed.get(name) or inputs.get(name) or numbers.get(name) or str for name in order}


def _common(kind: type | None, value: Any) -> type:
    """The kind of a column that held `kind` so far and now a value as well."""
    if value is None:
        return kind or type(None)
    new = type(value)
    if kind is None or kind is type(None) or kind is new:
        return new
    return float if {kind, new} == {int, float} else str


def _as(kind: type, value: Any) -> Any:
    if value is None or kind is type(None):
        return None
    if isinstance(value, kind) and not (kind is int and isinstance(value, bool)):
        return value
    return float(value) if kind is float else str(value)


def _write_parquet(path: Path, names: Columns, rows: Iterator[dict[str, Any]]) -> None:
    import pyarrow
    import pyarrow.parquet

    kinds = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    schema = pyarrow.schema([(name, kinds.get(kind, pyarrow.string())) for name, kind in names.items()])
    with pyarrow.parquet.ParquetWriter(str(path), schema) as writer:
        while some := [flat_row(row) for row in islice(rows, BATCH)]:
            columns = {name: [_as(kind, row.get(name)) for row in some] for name, kind in names.items()}
            writer.write_table(pyarrow.table(columns, schema=schema))


def _write_csv(path: Path, names: Columns, rows: Iterator[dict[str, Any]]) -> None:
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            flat = flat_row(row)
            writer.writerow(["" if (value := flat.get(name)) is None else value for name in names])


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
    """Tasks of the best and the worst row whose plans are missing. Raises InputError for an unknown column."""
    column = judged_by(study)
    done = [task for task in tasks if (key := bytes.fromhex(task.key)) in store.offsets and key not in store.failed]
    rows = [store.row(bytes.fromhex(task.key))["numbers"] for task in done]
    if rows and not any(column in row for row in rows):
        rule = f"is no number of this study, there are {', '.join(rows[0])}"
        raise InputError(rule, file=study.document.file, key="keep.by", value=column)
    return [
        done[k]
        for k in extremes(rows, column)
        if not all((store.plan_folder(done[k].index) / name).is_file() for name in files)
    ]


FEWEST = 4  # base samples or trajectories


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
    first, total, interval = _analysed(study, method, axis.values[rows], mean[rows])
    return Sensitivity(method, keys, first, total, interval, int(blocks.sum()), len(blocks))


def _analysed(study: StudyDefinition, method: str, x: Array, y: Array) -> tuple[Array, Array, Array]:
    definition = problem(distributed(study.entry))
    if method == "sobol":
        from SALib.analyze import sobol

        result = sobol.analyze(definition, y, calc_second_order=False, conf_level=LEVEL, seed=0)
        return np.asarray(result["S1"]), np.asarray(result["ST"]), np.asarray(result["ST_conf"])
    from SALib.analyze import morris

    result = morris.analyze(definition, x, y, num_levels=LEVELS, conf_level=LEVEL, seed=0)
    return np.asarray(result["sigma"]), np.asarray(result["mu_star"]), np.asarray(result["mu_star_conf"])
