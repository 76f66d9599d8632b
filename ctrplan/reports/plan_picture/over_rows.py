"""Figures over the rows of a path or a log: tip errors above, friction states of the pairs below."""

from __future__ import annotations

import io
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ctrplan.reports import palette

SIZE_IN, DPI = (11.0, 7.5), 120


def stacked(title: str, pairs: int, xlabel: str, heights: Sequence[float]) -> tuple[Figure, Axes, Axes | None]:
    """A figure with axes for errors, and for friction states where there are pairs; of relative heights."""
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white", layout="constrained")
    count = 2 if pairs else 1
    axes = figure.subplots(count, 1, sharex=True, squeeze=False, height_ratios=heights[:count])[:, 0]
    axes[0].set_title(title, loc="left", fontsize=14, fontweight="bold", color=palette.INK, parse_math=False)
    axes[-1].set_xlabel(xlabel)
    for ax in axes:
        ax.grid(color=palette.GRID, linewidth=0.8)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes[0], axes[1] if pairs else None


def png(figure: Figure) -> bytes:
    """The figure as a PNG file's content."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    return content.getvalue()


def label_errors(ax: Axes, label: str) -> None:
    """What errors over rows have in common, once they are drawn."""
    ax.margins(x=0.01)
    ax.set_ylim(bottom=0)
    ax.set_ylabel(label)
    ax.legend(frameon=False)


def label_friction(ax: Axes) -> None:
    """What friction states over rows have in common, once they are drawn."""
    ax.margins(x=0.01)
    ax.set_ylim(-1.05, 1.05)
    ax.set_ylabel("friction state")
    ax.legend(frameon=False, ncols=3)
