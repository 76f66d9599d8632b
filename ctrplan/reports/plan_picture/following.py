"""followed.png: how far measured tips are from those an observer expected, and from a simulation without it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ctrplan.base.arrays import Array
from ctrplan.reports import palette
from ctrplan.reports.plan_picture.over_rows import label_errors, label_friction, png, stacked
from ctrplan.studies.follow import Following


def following_figure(result: Following) -> Figure:
    """One-step-ahead errors above, friction states of the pairs below, over the rows. Made without pyplot."""
    figure, errors, friction = stacked(result.robot.name, result.robot.n - 1, "row of the log", (1, 1))
    row = np.asarray(result.data.rows + 1, dtype=np.float64)
    _draw_errors(errors, row, result)
    if friction:
        _draw_friction(friction, row, result)
    return figure


def following_png(result: Following) -> bytes:
    """The figure as a PNG file's content."""
    return png(following_figure(result))


def _draw_errors(ax: Axes, row: Array, result: Following) -> None:
    half_mm = np.linalg.norm(result.high_m - result.low_m, axis=1) / 2 * 1e3
    ax.fill_between(row, half_mm, color=palette.MET, alpha=0.15, linewidth=0, label="half of the observer's interval")
    ax.plot(row, result.error_without_m * 1e3, color=palette.MUTED, linewidth=1.5, label="without an observer")
    ax.plot(row, result.error_m * 1e3, color=palette.MET, linewidth=1.5, label="with the observer, one step ahead")
    label_errors(ax, "measured tip from the expected one (mm)")


def _draw_friction(ax: Axes, row: Array, result: Following) -> None:
    for pair in range(result.robot.n - 1):
        label = f"tubes {pair + 1} and {pair + 2}"
        ax.plot(row, result.friction[:, pair], color=palette.tube_colour(pair), label=label)
    label_friction(ax)
