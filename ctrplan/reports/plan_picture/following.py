"""followed.png: how far measured tips are from those an observer expected, and from a simulation without it."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ctrplan.base.arrays import Array
from ctrplan.reports import palette
from ctrplan.studies.follow import Following

SIZE_IN, DPI = (11.0, 7.5), 120


def following_figure(result: Following) -> Figure:
    """One-step-ahead errors above, friction states of the pairs below, over the rows. Made without pyplot."""
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white", layout="constrained")
    pairs = result.robot.n - 1
    axes = figure.subplots(2 if pairs else 1, 1, sharex=True, squeeze=False)[:, 0]
    axes[0].set_title(
        result.robot.name, loc="left", fontsize=14, fontweight="bold", color=palette.INK, parse_math=False
    )
    row = np.asarray(result.data.rows + 1, dtype=np.float64)
    _draw_errors(axes[0], row, result)
    if pairs:
        _draw_friction(axes[1], row, result)
    axes[-1].set_xlabel("row of the log")
    for ax in axes:
        ax.grid(color=palette.GRID, linewidth=0.8)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.margins(x=0.01)
    return figure


def following_png(result: Following) -> bytes:
    """The figure as a PNG file's content."""
    content = io.BytesIO()
    following_figure(result).savefig(content, format="png", dpi=DPI)
    return content.getvalue()


def _draw_errors(ax: Axes, row: Array, result: Following) -> None:
    half_mm = np.linalg.norm(result.high_m - result.low_m, axis=1) / 2 * 1e3
    ax.fill_between(row, half_mm, color=palette.MET, alpha=0.15, linewidth=0, label="half of the observer's interval")
    ax.plot(row, result.error_without_m * 1e3, color=palette.MUTED, linewidth=1.5, label="without an observer")
    ax.plot(row, result.error_m * 1e3, color=palette.MET, linewidth=1.5, label="with the observer, one step ahead")
    ax.set_ylim(bottom=0)
    ax.set_ylabel("measured tip from the expected one (mm)")
    ax.legend(frameon=False)


def _draw_friction(ax: Axes, row: Array, result: Following) -> None:
    for pair in range(result.robot.n - 1):
        label = f"tubes {pair + 1} and {pair + 2}"
        ax.plot(row, result.friction[:, pair], color=palette.tube_colour(pair), label=label)
    ax.set_ylim(-1.05, 1.05)
    ax.set_ylabel("friction state")
    ax.legend(frameon=False, ncols=3)
