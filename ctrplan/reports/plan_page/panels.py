"""Panels drawn by plotly, above each other over the same time, with a cursor across all."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ctrplan.reports import palette
from ctrplan.reports.curves import Panel, Series, Shade, Timeline
from ctrplan.reports.html_page import FONT

ROW_HEIGHT = 165
CURSOR = 0  # the shape that a script moves
DASHES = {"solid": "solid", "dotted": "dot"}


def stacked_figure(panels: Sequence[Panel], timeline: Timeline) -> go.Figure:
    """Panels with their headings, limits and marks; the legs are shaded by their kind."""
    count = len(panels)
    figure = make_subplots(rows=count, cols=1, shared_xaxes=True, vertical_spacing=52 / (ROW_HEIGHT * count))
    for row, panel in enumerate(panels, start=1):
        _add_panel(figure, row, panel, timeline)
    shades = (_shade(shade, row) for row in range(1, count + 1) for shade in timeline.shades)
    figure.update_layout(
        height=ROW_HEIGHT * count + 110,
        margin={"l": 70, "r": 20, "t": 60, "b": 50},
        shapes=[_cursor(0.0), *shades],
        hovermode="x unified",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"color": palette.INK, "size": 13, "family": FONT},
        uirevision="stays",
    )
    figure.update_xaxes(range=[0, timeline.end_s], showgrid=False)
    figure.update_xaxes(title_text="time (s)", ticks="outside", row=count, col=1)
    return figure


def _add_panel(figure: go.Figure, row: int, panel: Panel, timeline: Timeline) -> None:
    place = {"row": row, "col": 1}
    legend = "legend" if row == 1 else f"legend{row}"
    for series in panel.series:
        figure.add_trace(_curve(series, panel.unit, legend, shown=len(panel.series) > 1), **place)
    for limit in panel.limits:
        line = {"color": limit.colour, "width": 1.2, "dash": "dash"}
        ends = {"x": [0, timeline.end_s], "y": [limit.value, limit.value]}
        figure.add_scatter(**ends, mode="lines", line=line, hoverinfo="skip", showlegend=False, **place)
    for mark in panel.marks:
        if mark.has_point:
            _add_point(figure, timeline.duration_s, mark.value, mark.colour, place)
    rule = {"rangemode": "tozero"} if panel.from_zero else {}
    figure.update_yaxes(title_text=panel.unit, gridcolor=palette.GRID, zeroline=False, **place, **rule)
    _add_heading(figure, row, html.escape(panel.heading), legend)


def _curve(series: Series, unit: str, legend: str, *, shown: bool) -> Any:
    return go.Scatter(
        x=series.time_s.astype(np.float32),
        y=series.values.astype(np.float32),
        name=html.escape(series.name),
        mode="lines",
        line={"color": series.colour, "width": 2, "dash": DASHES[series.dash]},
        hovertemplate=f"%{{y:.4g}} {unit}",
        legend=legend,
        showlegend=shown,
    )


def _add_point(figure: go.Figure, time_s: float, value: float, colour: str, place: dict[str, int]) -> None:
    """At the end of a curve, whole although it stands on the axis's edge."""
    marker = {"color": colour, "size": 9}
    drawn = {"mode": "markers", "marker": marker, "cliponaxis": False, "hoverinfo": "skip", "showlegend": False}
    figure.add_scatter(x=[time_s], y=[value], **drawn, **place)


def _add_heading(figure: go.Figure, row: int, text: str, legend: str) -> None:
    """Text at the left above a panel, its legend at the right."""
    top = figure.layout["yaxis" if row == 1 else f"yaxis{row}"].domain[1]
    figure.add_annotation(
        text=f"<b>{text}</b>", x=0, y=top, xref="paper", yref="paper", xanchor="left", yanchor="bottom",
        showarrow=False, yshift=4,
    )  # fmt: skip
    place = {"orientation": "h", "x": 1, "xanchor": "right", "y": top, "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"}
    figure.update_layout({legend: place})


def _shade(shade: Shade, row: int) -> dict[str, Any]:
    """A rectangle behind the panel in `row`."""
    axis = f"y{'' if row == 1 else row} domain"
    return _upright(shade.start_s, shade.end_s, axis) | {"type": "rect", "fillcolor": shade.colour, "layer": "below"}


def _cursor(time_s: float) -> dict[str, Any]:
    """A line across all panels."""
    return _upright(time_s, time_s, "paper") | {"type": "line", "line": {"color": palette.INK, "width": 1.5}}


def _upright(start: float, end: float, axis: str) -> dict[str, Any]:
    """A shape over the whole height of an axis."""
    return {"x0": start, "x1": end, "y0": 0, "y1": 1, "xref": "x", "yref": axis, "line": {"width": 0}}
