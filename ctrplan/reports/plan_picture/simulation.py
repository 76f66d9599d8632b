"""simulate.png: how far the tip is from the frictionless solution along a joint path, under the friction bound."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ctrplan.mechanics.shapes import Status
from ctrplan.reports import palette
from ctrplan.reports.plan_picture.over_rows import label_errors, label_friction, png, stacked
from ctrplan.studies.simulate import Simulation

MOST_WAYPOINTS = 60  # that are marked


def simulation_figure(result: Simulation) -> Figure:
    """Tip deviation and bound above, friction states of the pairs below, over the waypoints. Made without pyplot."""
    figure, deviation, friction = stacked(result.robot.name, result.robot.n - 1, "row of the path", (2, 1))
    _draw_deviation(deviation, result)
    if friction:
        _draw_friction(friction, result)
    return figure


def simulation_png(result: Simulation) -> bytes:
    """The figure as a PNG file's content."""
    return png(simulation_figure(result))


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
    label_errors(ax, "tip from the frictionless solution (mm)")


def _draw_friction(ax: Axes, result: Simulation) -> None:
    for pair in range(result.robot.n - 1):
        colour, label = palette.tube_colour(pair), f"tubes {pair + 1} and {pair + 2}"
        for run in result.path.runs:
            rows = (result.place >= run.start) & (result.place <= run.stop - 1)
            ax.plot(
                result.place[rows] + 1, result.phi[rows, pair], color=colour, label=label if run.start == 0 else None
            )
    label_friction(ax)
