"""simulate.png: how far the tip is from the frictionless solution along a joint path, under the friction bound."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ctrplan.mechanics.core import Status
from ctrplan.reports import palette
from ctrplan.studies.simulate import Simulation

SIZE_IN, DPI = (11.0, 7.5), 120
MOST_WAYPOINTS = 60  # that are marked
PLAIN: dict[str, Any] = {"parse_math": False}


def simulation_figure(result: Simulation) -> Figure:
    """Tip deviation and bound above, friction states of the pairs below, over the waypoints. Made without pyplot."""
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white", layout="constrained")
    pairs = result.robot.n - 1
    axes = figure.subplots(2 if pairs else 1, 1, sharex=True, squeeze=False, height_ratios=[2, 1] if pairs else [1])[
        :, 0
    ]
    axes[0].set_title(result.robot.name, loc="left", fontsize=14, fontweight="bold", color=palette.INK, **PLAIN)
    _draw_deviation(axes[0], result)
    if pairs:
        _draw_friction(axes[1], result)
    axes[-1].set_xlabel("row of the path")
    for ax in axes:
        ax.grid(color=palette.GRID, linewidth=0.8)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.margins(x=0.01)
    return figure


def simulation_png(result: Simulation) -> bytes:
    """The figure as a PNG file's content."""
    content = io.BytesIO()
    simulation_figure(result).savefig(content, format="png", dpi=DPI)
    return content.getvalue()


def _draw_deviation(ax: Axes, result: Simulation) -> None:
    row, deviation_mm, bound_mm = result.place + 1, result.deviation_m * 1e3, result.bounds.position_m * 1e3
    unstable = result.bounds.status == Status.UNSTABLE
    for run in result.path.runs:
        rows = (result.place >= run.start) & (result.place <= run.stop - 1)
        names = ("worst-case bound", "predicted tip deviation") if run.start == 0 else (None, None)
        bound = np.where(unstable, np.nan, bound_mm)[rows]
        ax.fill_between(row[rows], bound, color=palette.BOUND, alpha=0.15, linewidth=0, label=names[0])
        ax.plot(row[rows], deviation_mm[rows], color=palette.BOUND, linewidth=2, label=names[1])
    at = result.waypoints
    if len(at) <= MOST_WAYPOINTS:
        ax.plot(row[at], deviation_mm[at], "o", color=palette.BOUND, markersize=4)
    snapped = np.flatnonzero(result.snaps)
    if len(snapped):
        ax.plot(row[snapped], deviation_mm[snapped], "v", color=palette.LIMIT, markersize=9, label="snap")
    ax.set_ylim(bottom=0)
    ax.set_ylabel("tip from the frictionless solution (mm)")
    ax.legend(frameon=False)


def _draw_friction(ax: Axes, result: Simulation) -> None:
    for pair in range(result.robot.n - 1):
        colour, label = palette.tube_colour(pair), f"tubes {pair + 1} and {pair + 2}"
        for run in result.path.runs:
            rows = (result.place >= run.start) & (result.place <= run.stop - 1)
            ax.plot(
                result.place[rows] + 1, result.phi[rows, pair], color=colour, label=label if run.start == 0 else None
            )
    ax.set_ylim(-1.05, 1.05)
    ax.set_ylabel("friction state")
    ax.legend(frameon=False, ncols=3)
