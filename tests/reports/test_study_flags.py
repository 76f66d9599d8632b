"""Rows of a user's function that found nothing valid, and numbers that are a yes or no, on a study's page."""

from __future__ import annotations

from typing import Any

from ctrplan.reports.study_figures import OUTCOMES, outcomes
from ctrplan.reports.study_tables import Quantity, is_flag, of_flags, of_numbers
from ctrplan.studies.study.table import StudyTable

COLUMNS: dict[str, list[Any]] = {
    "index": [0, 1, 2, 3, 4],
    "status": ["done", "done", "done", "no answer", "done"],
    "valid": [0, 3, 2, None, 5],
    "worst_mm": [None, 1.0, 3.0, None, None],  # of the last one, no configuration stays clear in every friction state
    "within_tolerance": [False, True, False, None, False],
    "free_within_1_mm": [True, True, False, None, False],
}
TABLE = StudyTable(COLUMNS)
SHOWN = [Quantity("valid", "valid configurations"), Quantity("free_within_1_mm", "free within 1 mm")]


def test_a_row_without_a_valid_configuration_is_not_reached() -> None:
    names = [OUTCOMES[k][0] for k in outcomes(TABLE)]
    not_reached = "not reached within limits and margins"
    assert names[0] == names[3] == names[4] == not_reached
    assert names[1].startswith("within tolerance") and names[2].startswith("reached, but friction")


def test_a_yes_or_no_has_a_share_and_no_median() -> None:
    assert is_flag(TABLE, "free_within_1_mm") and not is_flag(TABLE, "valid")
    numbers, flags = of_numbers(TABLE, SHOWN), of_flags(TABLE, SHOWN)
    assert flags == [["free within 1 mm", "4", "2", "50 %"]]
    assert [row[0] for row in numbers] == ["valid configurations"]
    assert not of_flags(TABLE, SHOWN[:1])
