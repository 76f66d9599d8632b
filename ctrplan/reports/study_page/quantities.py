"""What the columns of a study's table are called on its page, and which way of each is better."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.studies.study.definition import Definition
from ctrplan.studies.study.extremes import judged_by
from ctrplan.studies.study.table import FIRST, LAST, TIMING, StudyTable


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


def inputs_of(study: Definition, table: StudyTable) -> list[str]:
    """Columns of what is varied, in the table's order."""
    names = {name for axis in study.axes for name in axis.at(0).inputs}
    return [name for name in table.columns if name in names]


def quantities(study: Definition, table: StudyTable) -> list[Quantity]:
    """Numbers of the table that are not all alike, and what rows are judged by, which is first."""
    outside = {*FIRST, *LAST, *TIMING, *inputs_of(study, table)}
    known = {quantity.column: quantity for quantity in KNOWN}
    order = [judged_by(study), *known, *table.columns]
    found = []
    for column in dict.fromkeys(name for name in order if name in table.columns and name not in outside):
        values = table[column]
        is_judged = column == judged_by(study) and values.dtype == np.float64 and bool(np.isfinite(values).any())
        if is_judged or (values.dtype == np.float64 and spread(values) > 0):
            found.append(known.get(column) or _named(column, is_flag(table, column)))
    return found


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
