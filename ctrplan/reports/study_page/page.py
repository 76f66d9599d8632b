"""report.html of a study: what was asked, what came out, where, and why not elsewhere."""

from __future__ import annotations

from ctrplan.reports.html_page import page, tag
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.studies.study.study import Study
from ctrplan.studies.study.table import StudyTable


def write_study_report(study: Study, table: StudyTable) -> None:
    """Writes it into the study's folder."""
    assert table.folder is not None
    write_atomically(table.folder / "report.html", study_report_html(study, table))


def study_report_html(study: Study, table: StudyTable) -> str:
    """The content of report.html."""
    return page(f"Study - {study.name}", tag("h1", study.name))
