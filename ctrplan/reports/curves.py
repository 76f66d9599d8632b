"""What plan.png and report.html show over time: curves, their limits and marks, defined once and drawn by each."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.drive.drive import UNITS, Kind
from ctrplan.motion.limits import path_limits
from ctrplan.plans.planned_motion import leg_end_s, sample_time_s
from ctrplan.reports import looks
from ctrplan.reports.html_page import FIGURE_TEXT
from ctrplan.reports.words import millimetres

if TYPE_CHECKING:
    from ctrplan.plans.plan import Plan

Dash = Literal["solid", "dotted"]


@dataclass(frozen=True, eq=False)
class Series:
    """A line over time."""

    name: str
    time_s: Array  # (K,)
    values: Array  # (K,) in the panel's unit
    colour: str
    dash: Dash = "solid"


@dataclass(frozen=True)
class Limit:
    """A value that a panel's curves should not pass."""

    value: float  # in the panel's unit
    colour: str


@dataclass(frozen=True)
class Mark:
    """A value at the end of the motion that is worth its own words."""

    text: str
    value: float  # in the panel's unit
    colour: str
    has_point: bool  # on a curve; a limit has none


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves of one quantity on one axis over time."""

    title: str
    quantity: str  # as the axis calls it
    unit: str  # empty for pure numbers
    series: tuple[Series, ...]
    limits: tuple[Limit, ...] = ()
    limits_are: str = ""  # what the dashed lines mean
    marks: tuple[Mark, ...] = ()
    from_zero: bool = True

    @property
    def label(self) -> str:
        """The label of the axis: quantity and unit."""
        return f"{self.quantity} ({self.unit})" if self.unit else self.quantity

    @property
    def heading(self) -> str:
        """The title with what its dashed lines mean."""
        return f"{self.title}, dashed: {self.limits_are}" if self.limits else self.title


@dataclass(frozen=True)
class Shade:
    """The time that a leg takes, shaded by its kind."""

    start_s: float
    end_s: float
    kind: str
    colour: str


@dataclass(frozen=True)
class Timeline:
    """The axis that all panels of a plan share."""

    duration_s: float
    shades: tuple[Shade, ...]  # one per leg, in the order driven

    @property
    def end_s(self) -> float:
        """The end of the axis, never 0: a motion may take no time."""
        return max(self.duration_s, 1e-3)

    @property
    def kinds(self) -> dict[str, str]:
        """Colour by kind of the legs that there are."""
        return {shade.kind: shade.colour for shade in self.shades}


MOST_SAMPLES = 1500  # of a trajectory: more than there are pixels across


def timeline(plan: Plan) -> Timeline:
    """The plan's time, shaded by its legs."""
    ends = leg_end_s(plan).tolist()
    legs = zip([0.0, *ends[:-1]], ends, plan.legs, strict=True)
    shades = (Shade(start, end, leg.kind, looks.LEG_KINDS[leg.kind]) for start, end, leg in legs)
    return Timeline(plan.trajectory.duration_s, tuple(shades))


def error_panel(plan: Plan) -> Panel:
    """Friction error of the tip [mm]: worst case, prediction, how much the past may change, what is allowed."""
    samples, limit_m = plan.certificate.samples, plan.scenario.cost.max_error_goal_m
    time_s, bound_mm = sample_time_s(plan), samples.bound_m * MM_PER_M
    series = (
        Series("worst case", time_s, bound_mm, looks.BOUND),
        Series("predicted", time_s, samples.predicted_m * MM_PER_M, looks.BOUND, "dotted"),
        Series("spread", time_s, samples.spread_m * MM_PER_M, looks.INK, "dotted"),
    )
    stated_m = plan.certificate.goal_bound_m
    at_goal = Mark(f"at the goal\n{millimetres(stated_m)}", stated_m * MM_PER_M, looks.GOAL, True)
    title = "Friction error of the tip"
    if limit_m is None:
        return Panel(title, "error", "mm", series, marks=(at_goal,))
    allowed = Mark(f"allowed\n{millimetres(limit_m)}", limit_m * MM_PER_M, looks.LIMIT, False)
    limits = (Limit(limit_m * MM_PER_M, looks.LIMIT),)
    return Panel(title, "error", "mm", series, limits, "allowed at the goal", (at_goal, allowed))


def direction_panel(plan: Plan) -> Panel:
    """How far friction turns the tip's direction in the worst case [deg]."""
    return _sampled(
        plan,
        "Worst-case friction error of the tip's direction",
        "error",
        "deg",
        np.degrees(plan.certificate.samples.bound_rad),
        looks.BOUND,
    )


def margin_panels(plan: Plan) -> tuple[Panel, ...]:
    """Clearance [mm] (but in free space), stability and strain [%], each with what it must keep."""
    samples, limits = plan.certificate.samples, path_limits(plan.scenario)
    clearance_mm, least_mm = samples.clearance_m * MM_PER_M, limits.clearance_m * MM_PER_M
    rows = [
        ("Clearance beyond the margins", "clearance", "mm", clearance_mm, looks.CLEARANCE, least_mm, "least allowed"),
        ("Stability", "stability", "", samples.stability, looks.STABILITY, limits.stability, "least allowed"),
        ("Strain", "strain", "%", 100 * samples.max_strain, looks.STRAIN, 100 * limits.max_strain, "most allowed"),
    ]
    shown = rows if np.isfinite(samples.clearance_m).any() else rows[1:]
    return tuple(_sampled(plan, *row) for row in shown)


def position_panels(plan: Plan) -> tuple[Panel, ...]:
    """Joints between their limits: rotations [deg], translations [mm], those that there are."""
    kinds = [kind for kind in UNITS if any(joint.kind == kind for joint in plan.scenario.robot.drive.joints)]
    return tuple(_positions(plan, kind) for kind in kinds)


def speed_panel(plan: Plan) -> Panel:
    """Every joint's speed as a share of its limit [%]."""
    drive, trajectory, rows = plan.scenario.robot.drive, plan.trajectory, _shown_rows(plan)
    share = 100 * np.abs(trajectory.velocity[rows]) / drive.max_velocity
    series = tuple(
        Series(name, trajectory.time_s[rows], share[:, j], colour, "solid" if drive.is_rotation[j] else "dotted")
        for j, (name, colour) in enumerate(zip(drive.names, looks.joint_colours(drive), strict=True))
    )
    return Panel("Speeds", "speed", "% of limit", series, (Limit(100.0, looks.LIMIT),), "limit")


def _sampled(
    plan: Plan,
    title: str,
    quantity: str,
    unit: str,
    values: Array,
    colour: str,
    limit: float | None = None,
    limits_are: str = "",
) -> Panel:
    """One quantity at the certificate's samples."""
    limits = () if limit is None else (Limit(limit, looks.LIMIT),)
    return Panel(title, quantity, unit, (Series(title, sample_time_s(plan), values, colour),), limits, limits_are)


def _positions(plan: Plan, kind: Kind) -> Panel:
    drive, trajectory, rows, (unit, si) = plan.scenario.robot.drive, plan.trajectory, _shown_rows(plan), UNITS[kind]
    colours = looks.joint_colours(drive)
    chosen = [j for j, joint in enumerate(drive.joints) if joint.kind == kind]
    series = (
        Series(drive.names[j], trajectory.time_s[rows], trajectory.position[rows, j] / si, colours[j]) for j in chosen
    )
    ends = ((end / si, colours[j]) for j in chosen for end in (drive.lower[j], drive.upper[j]))
    limits = tuple(Limit(float(end), colour) for end, colour in ends if np.isfinite(end))
    return Panel(f"{kind.capitalize()}s", "position", unit, tuple(series), limits, "limits", from_zero=False)


def _shown_rows(plan: Plan) -> NDArray[np.int_]:
    """Rows of the trajectory that are drawn, the first and the last among them."""
    count = len(plan.trajectory.time_s)
    return np.unique(np.linspace(0, count - 1, MOST_SAMPLES).round().astype(int))


ROW_HEIGHT, HEADING = 180, 72  # pixels of a panel with its heading, of the heading alone
CURSOR = 0  # the shape that a script moves
DASHES = {"solid": "solid", "dotted": "dot"}
STROKES = {"solid": "\u2501\u2501", "dotted": "\u2509\u2509"}
NAMES_A_LINE = 3  # of curves in a heading: as many as a phone has room for


AXIS_TEXT = {"standoff": 10}  # pixels between an axis's numbers and its title


def stacked_figure(panels: Sequence[Panel], timeline: Timeline) -> dict[str, Any]:
    """Panels with their headings, limits and marks as a plain object of plotly.js; legs are shaded by their kind."""
    count = len(panels)
    gap = HEADING / (ROW_HEIGHT * count)
    height = (1 - gap * (count - 1)) / count
    layout: dict[str, Any] = {
        "height": ROW_HEIGHT * count + 110,
        "margin": {"l": 70, "r": 20, "t": 76, "b": 50},
        "showlegend": False,
        "shapes": [_cursor(0.0), *(_shade(shade, row) for row in range(1, count + 1) for shade in timeline.shades)],
        "annotations": [],
        "hovermode": "x unified",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": FIGURE_TEXT,
        "uirevision": "stays",
    }
    traces = list[dict[str, Any]]()
    for row, panel in enumerate(panels, start=1):
        number, top = "" if row == 1 else str(row), 1 - (row - 1) * (height + gap)
        x_axis = {"anchor": f"y{number}", "range": [0, timeline.end_s], "showgrid": False, "zeroline": False}
        if row > 1:
            x_axis["matches"] = "x"
        is_last: dict[str, Any] = (
            {"title": {"text": "time (s)", **AXIS_TEXT}, "ticks": "outside"} if row == count else {}
        )
        layout[f"xaxis{number}"] = x_axis | (is_last or {"showticklabels": False})
        rule = {"rangemode": "tozero"} if panel.from_zero else {}
        y_axis = {"anchor": f"x{number}", "domain": [max(top - height, 0.0), top], "gridcolor": looks.GRID}
        named = {"title": {"text": panel.unit, **AXIS_TEXT}, "zeroline": False, "automargin": True}
        layout[f"yaxis{number}"] = y_axis | named | rule
        layout["annotations"].append(_heading(panel, top))
        traces += [trace | {"xaxis": f"x{number}", "yaxis": f"y{number}"} for trace in _curves(panel, timeline)]
    return {"data": traces, "layout": layout}


def _curves(panel: Panel, timeline: Timeline) -> Iterator[dict[str, Any]]:
    """The curves, limits and marks of a panel."""
    quiet = {"type": "scatter", "hoverinfo": "skip", "showlegend": False}
    for series in panel.series:
        yield {
            "type": "scatter",
            "x": series.time_s.astype(np.float32),
            "y": series.values.astype(np.float32),
            "name": html.escape(series.name),
            "mode": "lines",
            "line": {"color": series.colour, "width": 2, "dash": DASHES[series.dash]},
            "hovertemplate": f"%{{y:.3g}} {panel.unit}",
        }
    for limit in panel.limits:
        line = {"color": limit.colour, "width": 1.2, "dash": "dash"}
        yield quiet | {"x": [0, timeline.end_s], "y": [limit.value] * 2, "mode": "lines", "line": line}
    for mark in panel.marks:
        if mark.has_point:  # at the end of a curve, whole although it stands on the axis's edge
            point = {"mode": "markers", "marker": {"color": mark.colour, "size": 9}, "cliponaxis": False}
            yield quiet | {"x": [timeline.duration_s], "y": [mark.value]} | point


def _heading(panel: Panel, top: float) -> dict[str, Any]:
    """Title at the left above a panel; under it the names of its curves in their colours, if there are several."""
    names = [
        f'<span style="color:{series.colour}">{STROKES[series.dash]} {html.escape(series.name)}</span>'
        for series in panel.series
    ]
    lines = ["\u2002".join(names[k : k + NAMES_A_LINE]) for k in range(0, len(names), NAMES_A_LINE)]
    text = "<br>".join([f"<b>{html.escape(panel.heading)}</b>", *(lines if len(names) > 1 else [])])
    place = {"x": 0, "y": top, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    return {"text": text, **place, "align": "left", "showarrow": False, "yshift": 4}


def _shade(shade: Shade, row: int) -> dict[str, Any]:
    """A rectangle behind the panel in `row`."""
    axis = f"y{'' if row == 1 else row} domain"
    return _upright(shade.start_s, shade.end_s, axis) | {"type": "rect", "fillcolor": shade.colour, "layer": "below"}


def _cursor(time_s: float) -> dict[str, Any]:
    """A line across all panels."""
    return _upright(time_s, time_s, "paper") | {"type": "line", "line": {"color": looks.INK, "width": 1.5}}


def _upright(start: float, end: float, axis: str) -> dict[str, Any]:
    """A shape over the whole height of an axis."""
    return {"x0": start, "x1": end, "y0": 0, "y1": 1, "xref": "x", "yref": axis, "line": {"width": 0}}
