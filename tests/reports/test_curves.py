"""plan.png and report.html draw the same curves, limits and marks: each panel is defined once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import plotly.graph_objects as go
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ctrplan.plans.plan import Plan
from ctrplan.reports import looks
from ctrplan.reports.curves import (
    CURSOR,
    Panel,
    direction_panel,
    error_panel,
    margin_panels,
    position_panels,
    speed_panel,
    timeline,
)
from ctrplan.reports.plan_page import joints_figure, margins_figure
from ctrplan.reports.plan_picture import plan_figure
from ctrplan.reports.plan_scene import plan_scene


@pytest.fixture(scope="module")
def bounded(make_plan: Callable[..., Plan]) -> Plan:
    """With a limit on the error at the goal and some anatomy."""
    sphere = {"kind": "sphere", "center_mm": [0, 60, 110], "radius_mm": 15}
    return make_plan(anatomy=[sphere], cost={"max_error_goal_mm": 2.0})


@pytest.fixture(scope="module")
def picture(bounded: Plan) -> Figure:
    return plan_figure(plan_scene(bounded, 2))


def drawn_by_matplotlib(ax: Axes, panel: Panel) -> list[np.ndarray]:
    """Values of the curves in the panel's colours; what spans the axis is limits and ends of legs."""
    colours = {series.colour.lower() for series in panel.series}
    lines = [line for line in ax.lines if len(line.get_ydata()) == len(panel.series[0].values)]
    assert {to_hex(line.get_color()) for line in lines} == colours
    return [np.asarray(line.get_ydata(), dtype=float) for line in lines]


def drawn_by_plotly(figure: go.Figure, panel: Panel) -> list[np.ndarray]:
    colours = {series.colour for series in panel.series}
    names = {series.name for series in panel.series}
    traces = [trace for trace in figure.data if trace.name in names and len(trace.y) == len(panel.series[0].values)]
    traces = [trace for trace in traces if trace.hovertemplate == f"%{{y:.3g}} {panel.unit}"]
    assert {trace.line.color for trace in traces} == colours
    return [np.asarray(trace.y, dtype=float) for trace in traces]


def test_both_draw_every_panel_alike(bounded: Plan, picture: Figure) -> None:
    margins, joints = go.Figure(margins_figure(bounded)), go.Figure(joints_figure(bounded))
    pages = [(panel, margins) for panel in (error_panel(bounded), *margin_panels(bounded)[:2])]
    pages += [(panel, joints) for panel in (*position_panels(bounded), speed_panel(bounded))]
    for panel, page in pages:
        ax = next(ax for ax in picture.axes if ax.get_ylabel() == panel.label)
        for series, a, b in zip(
            panel.series, drawn_by_matplotlib(ax, panel), drawn_by_plotly(page, panel), strict=True
        ):
            np.testing.assert_array_equal(a, series.values)
            np.testing.assert_array_equal(b.astype(np.float32), series.values.astype(np.float32))


def test_both_draw_the_limit_and_the_value_at_the_goal(bounded: Plan, picture: Figure) -> None:
    at_goal, allowed = error_panel(bounded).marks
    assert allowed.value == pytest.approx(2.0)
    assert at_goal.value == pytest.approx(1e3 * bounded.certificate.goal_bound_m)
    ax = next(ax for ax in picture.axes if ax.get_ylabel() == "error (mm)")
    assert {at_goal.text, allowed.text} <= {text.get_text() for text in ax.texts}
    dashed = [trace.y for trace in go.Figure(margins_figure(bounded)).data if trace.line.dash == "dash"]
    assert [2.0, 2.0] in [list(values) for values in dashed]
    points = [trace for trace in go.Figure(margins_figure(bounded)).data if trace.mode == "markers"]
    assert [point.y[0] for point in points] == [at_goal.value] and points[0].marker.color == looks.GOAL


def test_both_shade_the_legs_alike(bounded: Plan, picture: Figure) -> None:
    shades = timeline(bounded).shades
    assert [shade.kind for shade in shades] == [leg.kind for leg in bounded.legs]
    ax = next(ax for ax in picture.axes if ax.get_ylabel() == "error (mm)")
    assert [to_hex(patch.get_facecolor()) for patch in ax.patches] == [shade.colour.lower() for shade in shades]
    rectangles = go.Figure(margins_figure(bounded)).layout.shapes[CURSOR + 1 : CURSOR + 1 + len(shades)]
    assert [(r.x0, r.x1, r.fillcolor) for r in rectangles] == [(s.start_s, s.end_s, s.colour) for s in shades]


def test_a_heading_says_what_is_dashed_only_where_something_is(bounded: Plan) -> None:
    assert error_panel(bounded).heading == "Friction error of the tip, dashed: allowed at the goal"
    assert direction_panel(bounded).heading == direction_panel(bounded).title
    assert error_panel(bounded).label == "error (mm)" and margin_panels(bounded)[1].label == "stability"
