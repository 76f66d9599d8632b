"""Figures of a study's page: maps in space, sensitivities, trade-offs."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.reports import looks
from ctrplan.reports.html_page import FIGURE_TEXT
from ctrplan.reports.looks import view_box
from ctrplan.reports.plan_scene import anatomy_traces, laid_out, xyz
from ctrplan.reports.robot_surface import anatomy_surface
from ctrplan.reports.study_tables import Quantity
from ctrplan.reports.words import digits
from ctrplan.studies.study.study_definition import StudyDefinition
from ctrplan.studies.study.table import Sensitivity, StudyTable, sensitivity

MOST_POINTS = 20_000
MOST_MAPS = 6
TRIANGLES = 8_000
OUTCOMES = (
    ("within tolerance whatever friction does", looks.MET),
    ("reached, but friction may take it beyond the tolerance", looks.SERIES[1]),
    ("reached", looks.SERIES[0]),
    ("not reached within limits and margins", looks.LIMIT),
)
Indices = NDArray[np.int_]
Flags = NDArray[np.bool_]
Where = tuple[str, str, str]
TARGETS: Where = ("target_x_mm", "target_y_mm", "target_z_mm")
BASES: Where = ("base_x_mm", "base_y_mm", "base_z_mm")


@dataclass(frozen=True, eq=False)
class Places:
    """Points of a map, and which rows of the table belong to each."""

    points_mm: Array  # (P, 3)
    of_row: Indices  # (K,) index of the point of each row

    @classmethod
    def of(cls, table: StudyTable, where: Where) -> Places | None:
        """The distinct points; None where the study has none, or one."""
        if not all(name in table.columns for name in where):
            return None
        all_mm = np.column_stack([table[name] for name in where])
        points, of_row = np.unique(all_mm, axis=0, return_inverse=True)
        return cls(points, np.asarray(of_row, dtype=np.int_).reshape(-1)) if len(points) > 1 else None

    def mean(self, values: Array) -> Array:
        """(P,) mean over each point's rows that have a number; NaN where none has."""
        known = np.isfinite(values)
        count = np.bincount(self.of_row[known], minlength=len(self.points_mm))
        total = np.bincount(self.of_row[known], values[known], minlength=len(self.points_mm))
        mean: Array = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
        return mean


def map_figure(scenario: Any, table: StudyTable, places: Places, shown: list[Quantity]) -> go.Figure:
    """Shares where points stand for several rows, outcomes, then a quantity each, chosen by buttons."""
    rows = thinned_rows(len(places.points_mm))
    points_m = places.points_mm[rows] * 1e-3
    groups = [(share.name, [_value_trace(points_m, values[rows], share)]) for share, values in _shares(table, places)]
    groups.append(("outcome", _outcome_traces(table, places, rows)))
    for quantity in shown[:MOST_MAPS]:
        values = places.mean(table[quantity.column])[rows]
        if np.isfinite(values).any():
            groups.append((quantity.name, [_value_trace(points_m, values, quantity)]))
    parts = [] if scenario is None else list(scenario.anatomy)
    surfaces = [anatomy_surface(part, TRIANGLES) for part in parts]
    anatomy = anatomy_traces(scenario, surfaces) if parts else []
    for k, (_, group) in enumerate(groups):
        for trace in group:
            trace.visible = k == 0
    traces = [trace.to_plotly_json() for _, group in groups for trace in group]
    solid = np.concatenate([np.empty((0, 3)), *(surface.vertices_m for surface in surfaces)])
    figure = go.Figure(laid_out([*traces, *anatomy], *view_box(points_m, solid), points_m))
    _choose(figure, groups, len(anatomy))
    return figure


def thinned_rows(count: int) -> Indices:
    """All of so many rows, or as many as can be drawn."""
    if count <= MOST_POINTS:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:MOST_POINTS])


def outcomes(table: StudyTable) -> Indices:
    """(K,) index into OUTCOMES of each row."""
    result, done = np.full(len(table), 3), table.done & ~none_is_valid(table)
    if "within_tolerance" not in table.columns:
        result[done] = 2
        return result
    kept = table["within_tolerance"]
    result[done & (kept == 1)] = 0
    result[done & (kept == 0)] = 1
    result[done & np.isnan(kept)] = 2
    return result


def none_is_valid(table: StudyTable) -> Flags:
    """(K,) rows that are done and say that nothing was found, as functions may: none valid, or no error at worst."""
    result = np.zeros(len(table), dtype=bool)
    if "valid" in table.columns:
        result |= table["valid"] == 0
    if "worst_mm" in table.columns:
        result |= np.isnan(table["worst_mm"])
    return table.done & result


def _shares(table: StudyTable, places: Places) -> list[tuple[Quantity, Array]]:
    """(P,) shares of each point's rows that are worth a map; none where every point has one row."""
    if len(table) == len(places.points_mm):
        return []
    results = [(Quantity("", "share with an answer", "", 1), places.mean(table.done.astype(float)))]
    if "within_tolerance" in table.columns:
        kept = (table["within_tolerance"] == 1).astype(float)
        results.insert(0, (Quantity("", "share within tolerance whatever friction does", "", 1), places.mean(kept)))
    return results


def _outcome_traces(table: StudyTable, places: Places, rows: Indices) -> list[Any]:
    """A trace for each outcome; of several rows at a point the worst counts."""
    worst = np.zeros(len(places.points_mm), dtype=int)
    np.maximum.at(worst, places.of_row, outcomes(table))
    worst = worst[rows]
    traces = []
    for k, (name, colour) in enumerate(OUTCOMES):
        points_m = places.points_mm[rows][worst == k] * 1e-3
        if len(points_m):
            marker = {"size": _size(len(rows)), "color": colour, "opacity": 0.85}
            traces.append(go.Scatter3d(**xyz(points_m), mode="markers", marker=marker, name=name, hoverinfo="name"))
    return traces


def _value_trace(points_m: Array, values: Array, quantity: Quantity) -> Any:
    known = np.isfinite(values)
    marker = {
        "size": _size(len(values)),
        "color": values[known].astype(np.float32),
        "colorscale": "Viridis",
        "reversescale": quantity.is_better > 0,
        "colorbar": {"title": {"text": quantity.label, "side": "right"}, "thickness": 14, "len": 0.75},
        "opacity": 0.9,
    }
    hover = "%{marker.color:.3g}<extra></extra>"
    return go.Scatter3d(
        **xyz(points_m[known]), mode="markers", marker=marker, visible=False, hovertemplate=hover, showlegend=False
    )


def _size(count: int) -> float:
    return float(np.clip(60 / np.sqrt(max(count, 1)), 2.5, 7.0))


def _choose(figure: go.Figure, groups: list[tuple[str, list[Any]]], others: int) -> None:
    """Buttons above the scene, one for each group."""
    if len(groups) < 2:
        return
    buttons = []
    for name, _ in groups:
        visible = [other == name for other, traces in groups for _ in traces]
        buttons.append({"label": name, "method": "restyle", "args": [{"visible": [*visible, *[True] * others]}]})
    menu = {"type": "dropdown", "buttons": buttons, "x": 0.0, "xanchor": "left", "y": 1.0, "yanchor": "top"}
    figure.update_layout(updatemenus=[{**menu, "showactive": True, "bgcolor": "#fff"}])


ROW = 46  # pixels a key
WORDS = {
    "sobol": ("Share of the variance, alone", "Share, with all others", "Sobol' indices"),
    "morris": ("Their standard deviation", "Mean size of elementary effects", "Morris' elementary effects"),
}


def shown_sensitivity(study: StudyDefinition, rows: StudyTable, judged: Quantity | None) -> dict[str, Any] | None:
    """What a study's number depends on, drawn and in rows; None where nothing was drawn for it."""
    if judged is None or study.entry.draws.method == "random" or find_spec("SALib") is None:
        return None
    result = sensitivity(study, rows, judged.column)
    if result is None:
        return None
    first, total, title = WORDS[result.method]
    order = np.argsort(-np.nan_to_num(result.total)).tolist()
    lines = [
        [result.keys[k], digits(result.total[k]), f"± {digits(result.total_interval[k])}", digits(result.first[k])]
        for k in order
    ]
    kept = f"{result.used} of {result.count} {'base samples' if result.method == 'sobol' else 'trajectories'} were used"
    return {
        "title": title,
        "figure": _figure(result, order, total),
        "header": ["", total, "95 % interval", first],
        "rows": lines,
        "left_out": f"{kept}: in the others a task has no number." if result.used < result.count else "",
        "is_beyond": result.method == "sobol" and _is_beyond(result),
    }


def _is_beyond(result: Sensitivity) -> bool:
    shares = np.concatenate([result.first, result.total + result.total_interval])
    return bool(np.any((shares < 0) | (shares > 1)))


def _figure(result: Sensitivity, order: list[int], label: str) -> go.Figure:
    names = [result.keys[k] for k in order]
    figure = go.Figure(
        go.Bar(
            x=result.total[order],
            y=names,
            orientation="h",
            marker={"color": looks.SERIES[0]},
            error_x={"array": result.total_interval[order], "color": looks.MUTED},
        )
    )
    figure.update_layout(
        height=90 + ROW * len(names),
        margin={"l": 10, "r": 12, "t": 8, "b": 44},
        plot_bgcolor="#fff",
        font=FIGURE_TEXT,
    )
    figure.update_xaxes(title_text=label, gridcolor=looks.GRID, rangemode="tozero")
    figure.update_yaxes(autorange="reversed", automargin=True)
    return figure


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
    result = np.array(front, dtype=np.intp)
    return result[np.argsort(x[result], kind="stable")]


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
        cloud = {"color": looks.SERIES[0], "size": 5, "opacity": 0.5}
        line = {"color": looks.BOUND, "width": 2}
        points = go.Scattergl(x=x[rows], y=y[rows], mode="markers", marker=cloud, name="all", visible=k == 0)
        figure.add_trace(points)
        figure.add_trace(
            go.Scatter(x=x[front], y=y[front], mode="lines+markers", line=line, name="front", visible=k == 0)
        )
    _choose_axes(figure, [other for other, _ in shown])
    figure.update_layout(
        height=HEIGHT,
        margin={"l": 60, "r": 12, "t": 44, "b": 48},
        plot_bgcolor="#fff",
        font=FIGURE_TEXT,
        legend={"orientation": "h", "x": 1, "xanchor": "right", "y": 1.02, "yanchor": "bottom"},
    )
    figure.update_xaxes(title_text=judged.label, gridcolor=looks.GRID)
    figure.update_yaxes(gridcolor=looks.GRID)
    return figure


def _choose_axes(figure: go.Figure, others: list[Quantity]) -> None:
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
