"""Which of the drawn parameters matter: Sobol' or Morris indices as a table and bars."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import plotly.graph_objects as go

from ctrplan.reports import palette
from ctrplan.reports.html_page import FONT, Markup, plot, section, table, tag
from ctrplan.reports.plan_words.numbers import digits
from ctrplan.reports.study_page.quantities import Quantity
from ctrplan.studies.study.definition import Definition
from ctrplan.studies.study.sensitivity import Sensitivity, sensitivity
from ctrplan.studies.study.table import StudyTable

ROW = 46  # pixels a key
WORDS = {
    "sobol": ("Share of the variance, alone", "Share, with all others", "Sobol' indices"),
    "morris": ("Their standard deviation", "Mean size of elementary effects", "Morris' elementary effects"),
}

BEYOND = (
    "A share below 0 or above 1 is one that the samples are too few for: "
    "it is 0 or 1 within its interval, and draws.count makes it narrower."
)


def sensitivity_section(
    study: Definition, rows: StudyTable, judged: Quantity | None, library: list[bool]
) -> list[Markup]:
    """Nothing where nothing was drawn for it."""
    if judged is None or study.entry.draws.method == "random" or find_spec("SALib") is None:
        return []
    found = sensitivity(study, rows, judged.column)
    if found is None:
        return []
    first, total, title = WORDS[found.method]
    order = np.argsort(-np.nan_to_num(found.total))
    lines = [
        [found.keys[k], digits(found.total[k]), f"± {digits(found.total_interval[k])}", digits(found.first[k])]
        for k in order.tolist()
    ]
    drawn = plot(_figure(found, order.tolist(), total), "sensitivity", with_library=library[0])
    library[0] = False
    kept = f"{found.used} of {found.count} {'base samples' if found.method == 'sobol' else 'trajectories'} were used"
    left_out = tag("p", f"{kept}: in the others a task has no number.", kind="quiet hint")
    return [
        section(
            f"What {judged.name} depends on: {title}",
            drawn,
            table(["", total, "95 % interval", first], lines),
            left_out if found.used < found.count else "",
            tag("p", BEYOND, kind="quiet hint") if found.method == "sobol" and _is_beyond(found) else "",
        )
    ]


def _is_beyond(found: Sensitivity) -> bool:
    shares = np.concatenate([found.first, found.total + found.total_interval])
    return bool(np.any((shares < 0) | (shares > 1)))


def _figure(found: Sensitivity, order: list[int], label: str) -> go.Figure:
    names = [found.keys[k] for k in order]
    figure = go.Figure(
        go.Bar(
            x=found.total[order],
            y=names,
            orientation="h",
            marker={"color": palette.SERIES[0]},
            error_x={"array": found.total_interval[order], "color": palette.MUTED},
        )
    )
    figure.update_layout(
        height=90 + ROW * len(names),
        margin={"l": 10, "r": 12, "t": 8, "b": 44},
        plot_bgcolor="#fff",
        font={"color": palette.INK, "size": 13, "family": FONT},
    )
    figure.update_xaxes(title_text=label, gridcolor=palette.GRID, rangemode="tozero")
    figure.update_yaxes(autorange="reversed", automargin=True)
    return figure
