"""Base poses on a study's page: counted as they are, the best first."""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrplan.reports.study_page import COLUMNS, BasePoses
from ctrplan.studies.study.table import StudyTable

TILT = np.radians(10.0)
POSES = [(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, np.cos(TILT / 2), 0.0, np.sin(TILT / 2), 0.0)]


def rows(worst_mm: list[list[float | None]]) -> StudyTable:
    """Rows of a study from the worst errors of each pose's targets; None stands for one that was not reached."""
    columns: dict[str, list[Any]] = {name: [] for name in (*COLUMNS, "status", "worst_mm", "within_tolerance")}
    for pose, errors in zip(POSES, worst_mm, strict=True):
        for error in errors:
            for name, value in zip(COLUMNS, pose, strict=True):
                columns[name].append(value)
            columns["status"].append("no answer" if error is None else "done")
            columns["worst_mm"].append(error)
            columns["within_tolerance"].append(None if error is None else error <= 2)
    columns["index"] = list(range(len(columns["status"])))
    return StudyTable(columns, None)


def test_poses_are_counted() -> None:
    found = BasePoses.of(rows([[1.0, None, 3.0], [4.0, 5.0, 6.0]]), "worst_mm")
    assert found is not None
    assert found.count.tolist() == [3, 3] and found.reached.tolist() == [2, 3] and found.within.tolist() == [1, 0]
    np.testing.assert_allclose(found.mean, [2.0, 5.0])
    np.testing.assert_allclose(found.direction, [[0, 0, 1], [np.sin(TILT), 0, np.cos(TILT)]], atol=1e-12)


def test_the_best_reaches_most_then_keeps_most_within_tolerance() -> None:
    for errors, best in (
        ([[1.0, None], [3.0, 9.0]], 1),
        ([[1.0, 9.0], [3.0, 3.0]], 0),
        ([[1.0, 1.5], [1.0, 1.4]], 1),
        ([[None, None], [9.0, None]], 1),
    ):
        found = BasePoses.of(rows(errors), "worst_mm")
        assert found is not None and found.order[0] == best


def test_one_pose_is_no_comparison() -> None:
    table = rows([[1.0], [2.0]])
    one = StudyTable({name: values[:1] for name, values in table.columns.items()}, None)
    assert BasePoses.of(one, "worst_mm") is None
