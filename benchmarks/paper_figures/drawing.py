"""The look of the figures and tables."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from ctrplan.reports import looks

IMAGES = Path(__file__).resolve().parents[2] / "docs/images/validation"
COLOURS = (*looks.SERIES, looks.ENVELOPE)


def figure(panels: int, height_in: float = 3.7) -> tuple[Figure, list[Axes]]:
    fig = Figure(figsize=(9.6 if panels > 1 else 6.4, height_in), dpi=120, facecolor="white", layout="constrained")
    return fig, [prepare(fig.add_subplot(1, panels, k + 1)) for k in range(panels)]


def prepare(ax: Axes) -> Axes:
    ax.grid(color=looks.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(looks.MUTED)
    ax.tick_params(colors=looks.MUTED, labelcolor=looks.INK, labelsize=9)
    return ax


def label(ax: Axes, title: str, x: str, y: str) -> None:
    ax.set_title(title, loc="left", fontsize=10.5, color=looks.INK)
    ax.set_xlabel(x, fontsize=9.5, color=looks.INK)
    ax.set_ylabel(y, fontsize=9.5, color=looks.INK)


def legend(ax: Axes, title: str, checked: bool = False, **options: Any) -> None:
    """`checked`: there are values of the exact-geometry solver too."""
    handles, _ = ax.get_legend_handles_labels()
    if checked:
        handles.append(Line2D([], [], linestyle="", label="exact geometry", **hollow(looks.INK)))
    ax.legend(handles=handles, title=title, frameon=False, fontsize=8.5, title_fontsize=8.5, labelspacing=0.3,
              alignment="left", **options)  # fmt: skip


def hollow(colour: str) -> dict[str, Any]:
    return {"marker": "o", "ms": 4.5, "markerfacecolor": "white", "markeredgecolor": colour, "markeredgewidth": 1.1}


def points(ax: Axes, x: Sequence[float], y: Sequence[float], colour: str) -> None:
    ax.plot(x, y, linestyle="", zorder=3, **hollow(colour))


def save(fig: Figure, name: str) -> None:
    IMAGES.mkdir(parents=True, exist_ok=True)
    content = io.BytesIO()
    fig.savefig(content, format="png")
    small = Image.open(content).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    small.save(IMAGES / f"{name}.png", optimize=True)


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(cell) for cell in line) + " |\n" for line in lines)
