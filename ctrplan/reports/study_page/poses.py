"""Base poses of a study as what a person asks of them: how much each reaches, and how well, the best first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.reports.html_page import Markup, table, tag
from ctrplan.reports.plan_words.numbers import digits
from ctrplan.reports.study_page.quantities import Quantity
from ctrplan.studies.study.table import StudyTable

COLUMNS = (*(f"base_{axis}_mm" for axis in "xyz"), *(f"base_q{axis}" for axis in "wxyz"))
MOST_ROWS = 20


@dataclass(frozen=True, eq=False)
class BasePoses:
    """P poses, each with its rows of the table."""

    position_mm: Array  # (P, 3)
    direction: Array  # (P, 3) of the robot's z axis
    count: NDArray[np.int_]  # (P,) tasks
    reached: NDArray[np.int_]  # of them with an answer
    within: NDArray[np.int_]  # of those within tolerance whatever friction does; 0 where the study says nothing of it
    mean: Array  # of what rows are judged by, over those with an answer; NaN where there is none

    @classmethod
    def of(cls, rows: StudyTable, column: str) -> BasePoses | None:
        """Of a study with several base poses, by a column of which less is better; None of another."""
        if not all(name in rows.columns for name in (*COLUMNS, column)):
            return None
        each = np.column_stack([rows[name] for name in COLUMNS])
        poses, of_row = np.unique(each, axis=0, return_inverse=True)
        of_row = of_row.reshape(-1)
        if len(poses) < 2:
            return None

        def counted(flags: NDArray[np.bool_]) -> NDArray[np.int_]:
            return np.bincount(of_row[flags], minlength=len(poses))

        values = rows[column]
        known = rows.done & np.isfinite(values)
        total = np.bincount(of_row[known], values[known], minlength=len(poses))
        count = counted(known)
        mean = np.divide(total, count, out=np.full(len(poses), np.nan), where=count > 0)
        within = (
            rows["within_tolerance"] == 1 if "within_tolerance" in rows.columns else np.zeros(len(rows), dtype=bool)
        )
        direction = Rotation.from_quat(np.roll(poses[:, 3:], -1, axis=1)).apply([0.0, 0.0, 1.0])
        everything = np.ones(len(rows), dtype=bool)
        return cls(poses[:, :3], direction, counted(everything), counted(rows.done), counted(within), mean)

    @property
    def order(self) -> NDArray[np.int_]:
        """The best first: most with an answer, then most within tolerance, then the least mean."""
        return np.lexsort((np.nan_to_num(self.mean, nan=np.inf), -self.within, -self.reached))


def poses_table(rows: StudyTable, judged: Quantity) -> Markup | None:
    """The best poses of a study; None where it has none, or one."""
    poses = BasePoses.of(rows, judged.column)
    if poses is None:
        return None
    lines = [
        [
            _vector(poses.position_mm[k], 1),
            _vector(poses.direction[k], 3),
            f"{poses.reached[k]} of {poses.count[k]}",
            f"{poses.within[k]}",
            digits(float(poses.mean[k])) if np.isfinite(poses.mean[k]) else "-",
        ]
        for k in poses.order[:MOST_ROWS].tolist()
    ]
    head = ["Position (mm)", "Looks along", "With an answer", "Within tolerance whatever friction does"]
    shown = f"The best {len(lines)} of {len(poses.count)}." if len(lines) < len(poses.count) else ""
    return Markup(table([*head, f"Mean of {judged.label}"], lines) + tag("p", shown, kind="quiet hint"))


def _vector(numbers: Array, places: int) -> str:
    return " ".join(f"{x + 0.0:.{places}f}" for x in numbers.round(places).tolist())
