"""Panels drawn by matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ctrplan.reports import palette
from ctrplan.reports.curves import Mark, Panel, Timeline

LIMIT: dict[str, Any] = {"linestyle": "--", "linewidth": 1.1}
DASHES: dict[str, Literal["-", ":"]] = {"solid": "-", "dotted": ":"}
KEY: dict[str, Any] = {
    "frameon": False, "fontsize": 10, "handlelength": 1.6, "columnspacing": 1.2, "borderaxespad": 0.2,
}  # fmt: skip


def draw_panel(ax: Axes, panel: Panel, timeline: Timeline, *, heading: str = "") -> None:
    """A panel with its marks in words at its right end, and a legend of its curves or a heading in place of one."""
    _prepare(ax, timeline, heading or panel.title)
    ax.set_ylabel(panel.label)
    _draw_curves(ax, panel)
    if panel.from_zero:
        ax.set_ylim(0, 1.12 * max(_largest(panel), 1e-3))
    else:
        ax.margins(y=0.12)
    _draw_marks(ax, panel.marks, timeline)
    if not heading:
        _legend(ax, panel)


def draw_pair(ax: Axes, left: Panel, right: Panel, timeline: Timeline) -> None:
    """Two panels of one curve each in the same place, an axis at each side in the colour of its curve."""
    _prepare(ax, timeline, f"{left.title}, and {right.quantity}; dashed: their limits")
    other = ax.twinx()
    other.spines["top"].set_visible(False)
    for side, panel in ((ax, left), (other, right)):
        colour = panel.series[0].colour
        _draw_curves(side, panel, colour)
        values = [*panel.series[0].values, *(limit.value for limit in panel.limits), 0.0]
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        side.set_ylim(low - 0.08 * (high - low), high + 0.12 * (high - low))
        side.set_ylabel(panel.label, color=colour)
        side.tick_params(axis="y", colors=colour)


def draw_leg_key(figure: Figure, timeline: Timeline, corner: tuple[float, float]) -> None:
    """What the shades of the legs mean; `corner`: its lower right one, of the figure's width and height."""
    patches = [Patch(facecolor=colour, edgecolor=palette.MUTED, linewidth=0.4) for colour in timeline.kinds.values()]
    names = [f"{kind} leg" for kind in timeline.kinds]
    figure.legend(patches, names, loc="lower right", bbox_to_anchor=corner, ncols=len(names), **KEY)


def _prepare(ax: Axes, timeline: Timeline, heading: str) -> None:
    """Axis over time with its legs shaded by kind."""
    ax.set_title(heading, loc="left", fontsize=11.5, fontweight="bold", color=palette.INK)
    ax.set_xlim(0, timeline.end_s)
    for shade in timeline.shades:
        ax.axvspan(shade.start_s, shade.end_s, facecolor=shade.colour, edgecolor="none", zorder=0)
        ax.axvline(shade.end_s, color=palette.MUTED, linewidth=0.6, zorder=0.5)
    ax.grid(axis="y", color=palette.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=10, colors=palette.INK)


def _draw_curves(ax: Axes, panel: Panel, limit_colour: str | None = None) -> None:
    for series in panel.series:
        ax.plot(series.time_s, series.values, DASHES[series.dash], color=series.colour, linewidth=2)
    for limit in panel.limits:
        ax.axhline(limit.value, color=limit_colour or limit.colour, **LIMIT)


def _largest(panel: Panel) -> float:
    """Of everything drawn in the panel, 0 at least."""
    drawn = [series.values[np.isfinite(series.values)] for series in panel.series]
    return float(np.concatenate([*drawn, [limit.value for limit in panel.limits], [0.0]]).max())


def _draw_marks(ax: Axes, marks: Sequence[Mark], timeline: Timeline) -> None:
    """Points, and texts beside the right end of an axis from 0, moved apart where they would overlap."""
    top, place = ax.get_ylim()[1], 0.08
    for mark in sorted(marks, key=lambda mark: mark.value):
        if mark.has_point:
            ax.plot(timeline.duration_s, mark.value, "o", color=mark.colour, markersize=7, clip_on=False)
        place = max(mark.value / top, place)
        style: dict[str, Any] = {"color": mark.colour, "va": "center", "fontsize": 10.5, "fontweight": "bold"}
        ax.text(1.012, place, mark.text, transform=ax.transAxes, **style)
        place += 0.26


def _legend(ax: Axes, panel: Panel) -> None:
    """Above the axis, right, so that it covers nothing; names stand as they are, dollar signs included."""
    handles = [Line2D([], [], color=s.colour, linestyle=DASHES[s.dash], linewidth=2) for s in panel.series]
    names = [series.name for series in panel.series]
    if panel.limits and not panel.marks:  # marks say what their limit is
        handles.append(Line2D([], [], color=palette.MUTED, **LIMIT))
        names.append(panel.limits_are)
    legend = ax.legend(handles, names, loc="lower right", bbox_to_anchor=(1.0, 0.985), ncols=len(names), **KEY)
    for text in legend.get_texts():
        text.set_parse_math(False)
