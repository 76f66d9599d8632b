"""The report's curves over time: errors and margins, joint positions and speeds, legs shaded by their kind."""

from __future__ import annotations

import html
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import UNITS, Kind
from ctrplan.planning.motion import path_limits
from ctrplan.planning.plan_timing import leg_end_s, sample_time_s
from ctrplan.reports import palette
from ctrplan.reports.html_page import FONT

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan

MOST_SAMPLES = 1500  # of a trajectory: more than there are pixels across
ROW_HEIGHT = 165
CURSOR = 0  # the shape that a script moves


@dataclass(frozen=True)
class Curve:
    """A line over time."""

    name: str
    values: Array
    colour: str
    dash: str = "solid"


@dataclass(frozen=True)
class Panel:
    """Curves on one axis, and the values they should not pass."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    limits: tuple[tuple[float, str], ...] = ()  # value, colour
    from_zero: bool = False


def margins_figure(plan: Plan) -> go.Figure:
    """What the certificate found along the path, with what it requires as dashed lines."""
    samples, limits, limit_m = plan.certificate.samples, path_limits(plan.scenario), plan.scenario.cost.max_error_goal_m
    allowed = () if limit_m is None else ((limit_m * 1e3, palette.LIMIT),)
    error = "Worst-case friction error of the tip" + (", dashed: allowed at the goal" if allowed else "")
    panels = [
        Panel(
            error,
            "mm",
            (
                Curve("worst case", samples.bound_m * 1e3, palette.BOUND),
                Curve("predicted by history", samples.predicted_m * 1e3, palette.BOUND, "dot"),
            ),
            allowed,
            from_zero=True,
        ),
        _single(
            "Worst-case friction error of the tip's direction", "deg", np.degrees(samples.bound_rad), palette.BOUND
        ),
    ]
    if np.isfinite(samples.clearance_m).any():
        clearance_mm = samples.clearance_m * 1e3
        title = "Clearance to the anatomy beyond its margins, dashed: least allowed"
        least = (limits.clearance_m * 1e3, palette.LIMIT)
        panels.append(_single(title, "mm", clearance_mm, palette.CLEARANCE, (least,)))
    stability, strain = (limits.stability, palette.LIMIT), (limits.max_strain * 100, palette.LIMIT)
    panels.append(
        _single(
            "Stability (dimensionless), dashed: least allowed", "", samples.stability, palette.STABILITY, (stability,)
        )
    )
    panels.append(_single("Strain, dashed: most allowed", "%", samples.max_strain * 100, palette.STRAIN, (strain,)))
    return _figure(plan, sample_time_s(plan), panels)


def joints_figure(plan: Plan) -> go.Figure:
    """Joint positions between their limits, and speeds as shares of theirs."""
    drive, trajectory = plan.scenario.robot.drive, plan.trajectory
    rows = np.unique(np.linspace(0, len(trajectory.time_s) - 1, MOST_SAMPLES).round().astype(int))
    colours = palette.joint_colours(drive)
    panels = [_positions(plan, kind, rows) for kind in UNITS if any(joint.kind == kind for joint in drive.joints)]
    share = 100 * np.abs(trajectory.velocity[rows]) / drive.max_velocity
    speeds = tuple(
        Curve(name, share[:, j], colours[j], "solid" if drive.is_rotation[j] else "dot")
        for j, name in enumerate(drive.names)
    )
    panels.append(Panel("Speeds", "% of limit", speeds, ((100.0, palette.LIMIT),), True))
    return _figure(plan, trajectory.time_s[rows], panels)


def _single(title: str, unit: str, values: Array, colour: str, limits: tuple[tuple[float, str], ...] = ()) -> Panel:
    return Panel(title, unit, (Curve(title.split(",")[0], values, colour),), limits, True)


def _positions(plan: Plan, kind: Kind, rows: Array) -> Panel:
    drive, (unit, si) = plan.scenario.robot.drive, UNITS[kind]
    colours = palette.joint_colours(drive)
    chosen = [j for j, joint in enumerate(drive.joints) if joint.kind == kind]
    curves = tuple(Curve(drive.names[j], plan.trajectory.position[rows, j] / si, colours[j]) for j in chosen)
    ends = ((limit / si, colours[j]) for j in chosen for limit in (drive.lower[j], drive.upper[j]))
    limits = tuple((limit, colour) for limit, colour in ends if np.isfinite(limit))
    return Panel(f"{kind.capitalize()}s" + (", dashed: limits" if limits else ""), unit, curves, limits)


def _figure(plan: Plan, time_s: Array, panels: list[Panel]) -> go.Figure:
    """Panels above each other over the same time."""
    count = len(panels)
    gap = 52 / (ROW_HEIGHT * count)
    figure = make_subplots(rows=count, cols=1, shared_xaxes=True, vertical_spacing=gap)
    for row, panel in enumerate(panels, start=1):
        _add_panel(figure, row, panel, time_s)
    figure.update_layout(
        height=ROW_HEIGHT * count + 110,
        margin={"l": 70, "r": 20, "t": 60, "b": 50},
        shapes=[_cursor(plan.trajectory.duration_s), *(leg for row in range(1, count + 1) for leg in _legs(plan, row))],
        hovermode="x unified",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"color": palette.INK, "size": 13, "family": FONT},
        uirevision="stays",
    )
    figure.update_xaxes(range=[0, max(plan.trajectory.duration_s, 1e-3)], showgrid=False)
    figure.update_xaxes(title_text="time (s)", ticks="outside", row=count, col=1)
    return figure


def _add_panel(figure: go.Figure, row: int, panel: Panel, time_s: Array) -> None:
    several = len(panel.curves) > 1
    legend = "legend" if row == 1 else f"legend{row}"
    for curve in panel.curves:
        figure.add_scatter(
            x=time_s.astype(np.float32),
            y=curve.values.astype(np.float32),
            name=html.escape(curve.name),
            mode="lines",
            line={"color": curve.colour, "width": 2, "dash": curve.dash},
            hovertemplate=f"%{{y:.4g}} {panel.unit}",
            legend=legend,
            showlegend=several,
            row=row,
            col=1,
        )
    for value, colour in panel.limits:
        figure.add_scatter(
            x=time_s[[0, -1]], y=[value, value], mode="lines", line={"color": colour, "width": 1.2, "dash": "dash"},
            hoverinfo="skip", showlegend=False, row=row, col=1,
        )  # fmt: skip
    rule = {"rangemode": "tozero"} if panel.from_zero else {}
    figure.update_yaxes(title_text=panel.unit, gridcolor=palette.GRID, zeroline=False, row=row, col=1, **rule)
    top = figure.layout["yaxis" if row == 1 else f"yaxis{row}"].domain[1]
    figure.add_annotation(
        text=f"<b>{panel.title}</b>", x=0, y=top, xref="paper", yref="paper", xanchor="left", yanchor="bottom",
        showarrow=False, yshift=4,
    )  # fmt: skip
    place = {"orientation": "h", "x": 1, "xanchor": "right", "y": top, "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"}
    figure.update_layout({legend: place})


def _legs(plan: Plan, row: int) -> list[dict[str, Any]]:
    """Rectangles behind the panel in `row`, one per leg."""
    ends = leg_end_s(plan)
    starts = np.concatenate([[0.0], ends[:-1]])
    axis = f"y{'' if row == 1 else row} domain"
    return [
        _upright(start, end, axis) | {"type": "rect", "fillcolor": palette.LEG_KINDS[leg.kind], "layer": "below"}
        for start, end, leg in zip(starts.tolist(), ends.tolist(), plan.legs, strict=True)
    ]


def _cursor(time_s: float) -> dict[str, Any]:
    """A line across all panels."""
    return _upright(time_s, time_s, "paper") | {"type": "line", "line": {"color": palette.INK, "width": 1.5}}


def _upright(start: float, end: float, axis: str) -> dict[str, Any]:
    """A shape over the whole height of an axis."""
    return {"x0": start, "x1": end, "y0": 0, "y1": 1, "xref": "x", "yref": axis, "line": {"width": 0}}
