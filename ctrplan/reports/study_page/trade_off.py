"""Trade-offs: what rows are judged by against another quantity, and the rows that nothing else is better than."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.reports import palette
from ctrplan.reports.html_page import FONT
from ctrplan.reports.study_page.maps import thinned_rows
from ctrplan.reports.study_page.quantities import Quantity
from ctrplan.studies.study.table import StudyTable

HEIGHT = 380
FEWEST = 3


def pareto_front(x: Array, y: Array, x_better: int, y_better: int) -> NDArray[np.intp]:
    """Rows that no other is better than in one of two numbers and as good in the other, by rising x."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    order = known[np.lexsort((-y_better * y[known], -x_better * x[known]))]  # best x first, of those the best y
    best, front = -np.inf, []
    for k in order.tolist():
        if y_better * y[k] > best:
            best = y_better * y[k]
            front.append(k)
    found = np.array(front, dtype=np.intp)
    return found[np.argsort(x[found], kind="stable")]


def trade_off_figure(table: StudyTable, judged: Quantity, others: list[Quantity]) -> go.Figure | None:
    """A cloud of all rows for each of the others, with its front; None where there is nothing to weigh."""
    x = table[judged.column]
    shown = []
    for other in sorted(others, key=lambda quantity: -quantity.is_better):  # what more of is better pulls the other way
        y = table[other.column]
        if other.is_better and other.column != judged.column and np.sum(np.isfinite(x) & np.isfinite(y)) >= FEWEST:
            shown.append((other, y))
    if not shown:
        return None
    figure = go.Figure()
    for k, (other, y) in enumerate(shown):
        rows = thinned_rows(len(x))
        front = pareto_front(x, y, judged.is_better or -1, other.is_better)
        cloud = {"color": palette.SERIES[0], "size": 5, "opacity": 0.5}
        line = {"color": palette.BOUND, "width": 2}
        points = go.Scattergl(x=x[rows], y=y[rows], mode="markers", marker=cloud, name="tasks", visible=k == 0)
        figure.add_trace(points)
        figure.add_trace(
            go.Scatter(x=x[front], y=y[front], mode="lines+markers", line=line, name="front", visible=k == 0)
        )
    _choose(figure, [other for other, _ in shown])
    figure.update_layout(
        height=HEIGHT,
        margin={"l": 60, "r": 12, "t": 44, "b": 48},
        plot_bgcolor="#fff",
        font={"color": palette.INK, "size": 13, "family": FONT},
        legend={"orientation": "h", "x": 1, "xanchor": "right", "y": 1.02, "yanchor": "bottom"},
    )
    figure.update_xaxes(title_text=judged.label, gridcolor=palette.GRID)
    figure.update_yaxes(gridcolor=palette.GRID)
    return figure


def _choose(figure: go.Figure, others: list[Quantity]) -> None:
    figure.update_yaxes(title_text=others[0].label)
    if len(others) < 2:
        return
    buttons = [
        {
            "label": other.name,
            "method": "update",
            "args": [
                {"visible": [j == k for j in range(len(others)) for _ in range(2)]},
                {"yaxis.title.text": other.label},
            ],
        }
        for k, other in enumerate(others)
    ]
    menu = {"type": "dropdown", "buttons": buttons, "x": 0, "xanchor": "left", "y": 1.16, "yanchor": "top"}
    figure.update_layout(updatemenus=[{**menu, "bgcolor": "#fff"}])
