"""What the sections of benchmarks/history.py share: robots, tables, figures and the page docs/history.md."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from page_table import put_into_page
from PIL import Image

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.reports import looks

ROOT = Path(__file__).resolve().parents[1]
PAGE, IMAGES = ROOT / "docs" / "history.md", ROOT / "docs" / "images" / "history"
BEGIN, END = "<!-- table: {} -->\n", "<!-- end of table -->"
COLOURS = (*looks.SERIES, looks.ENVELOPE, looks.CORNER)
PAIR = load_robot(ROOT / "scenarios" / "robots" / "table_5_pair.toml")
THREE = load_robot(ROOT / "scenarios" / "robots" / "three_tube.toml")
PAIR_L_M = np.array([0.0, -0.0604])  # curved part of the inner tube half extended


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def present(name: str, text: str, write: bool) -> None:
    """Prints a table and puts it between its marks in the page."""
    print(f"\n{name}\n{text}", end="", flush=True)
    if write:
        put_into_page(PAGE, BEGIN.format(name), text, END)


def draw(name: str, figure: Figure, write: bool) -> None:
    """Saves a figure for the page, in few colours to keep it small."""
    if not write:
        return
    IMAGES.mkdir(parents=True, exist_ok=True)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110)
    Image.open(content).convert("RGB").quantize(256).save(IMAGES / f"{name}.png", optimize=True)


def panels(rows: int, columns: int, size_in: tuple[float, float], **options: Any) -> tuple[Figure, Any]:
    """A figure with axes in the style of the other pages."""
    figure = Figure(figsize=size_in, facecolor="white", layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for ax in axes.flat:
        style(ax)
    return figure, axes


def style(ax: Axes) -> None:
    ax.grid(color=looks.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def norm_mm(vectors: Array) -> Array:
    """(...,) lengths in mm of (..., 3) in m."""
    length: Array = 1e3 * np.linalg.norm(vectors, axis=-1)
    return length
