"""sweep.png: the friction bound as a curve over one axis or a heat map over two."""

from __future__ import annotations

import io
import textwrap
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import Status
from ctrplan.reports import palette
from ctrplan.studies.sweep import Sweep
from ctrplan.studies.sweep_axis import SweepAxis

SIZE_IN, DPI = (10.0, 7.0), 120
BOUND_LABEL = "worst-case friction error of the tip (mm)"
MOST_MARKERS = 60
WIDEST_CAPTION, WIDEST_NAME = (
    110,
    70,
)  # letters across the figure; wider ones leave the axes no room
PLAIN: dict[str, Any] = {"parse_math": False}
UNUSABLE = {  # status -> colour, hatch, words
    Status.UNSTABLE: (palette.UNSTABLE, "///", "unstable: the robot would snap"),
    Status.FAILED: (palette.FAILED, "", "failed: no bound is promised"),
}


def sweep_figure(result: Sweep) -> Figure:
    """The bound over the axes; where there is none, grey says why. Made without pyplot, no global state."""
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white", layout="constrained")
    ax = figure.add_subplot()
    caption = textwrap.wrap(_caption(result), WIDEST_CAPTION)
    name, pad = textwrap.shorten(result.robot.name, WIDEST_NAME, placeholder=" ..."), 12 + 14 * max(1, len(caption))
    ax.set_title(name, loc="left", fontsize=14, fontweight="bold", color=palette.INK, pad=pad, **PLAIN)
    ax.text(0, 1.02, "\n".join(caption), transform=ax.transAxes, color=palette.MUTED, fontsize=10)
    ax.set_xlabel(result.axes[0].label, **PLAIN)
    (_draw_curve if len(result.axes) == 1 else _draw_map)(ax, result)
    shown = [status for status in UNUSABLE if status in _status(result)]
    patches = [Patch(facecolor=UNUSABLE[s][0], hatch=UNUSABLE[s][1], edgecolor=palette.MUTED) for s in shown]
    if shown:
        figure.legend(patches, [UNUSABLE[s][2] for s in shown], loc="outside lower left", frameon=False, ncols=2)
    return figure


def sweep_png(result: Sweep) -> bytes:
    """The figure as a PNG file's content."""
    content = io.BytesIO()
    with rc_context({"hatch.linewidth": 0.6, "hatch.color": palette.MUTED}):
        sweep_figure(result).savefig(content, format="png", dpi=DPI)
    return content.getvalue()


def _draw_curve(ax: Axes, result: Sweep) -> None:
    axis, status = result.axes[0], _status(result)
    marker = "o" if len(axis.values) <= MOST_MARKERS else ""
    ax.plot(axis.values, _bound_mm(result), color=palette.BOUND, linewidth=2, marker=marker, markersize=4)
    starts = np.flatnonzero(np.diff(status, prepend=-1))
    half = (axis.values[1] - axis.values[0]) / 2
    for first, end in zip(starts.tolist(), [*starts[1:].tolist(), len(status)], strict=True):
        if status[first] in UNUSABLE:
            colour, hatch, _ = UNUSABLE[Status(status[first])]
            edges = axis.values[first] - half, axis.values[end - 1] + half
            ax.axvspan(*edges, facecolor=colour, hatch=hatch, edgecolor=palette.MUTED, linewidth=0, zorder=0)
    ax.set_xlim(*sorted(axis.values[[0, -1]]))
    ax.set_ylim(bottom=0)
    ax.set_ylabel(BOUND_LABEL)
    ax.grid(color=palette.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def _draw_map(ax: Axes, result: Sweep) -> None:
    x, y = result.axes
    placed: dict[str, Any] = {"extent": (*_ends(x), *_ends(y)), "origin": "lower", "aspect": "auto"}
    bound_mm = _bound_mm(result).reshape(result.shape).T
    if result.usable.any():
        image = ax.imshow(bound_mm, cmap=palette.HEAT, vmin=0, **placed)
        ax.figure.colorbar(image, ax=ax, label=BOUND_LABEL)
    status = _status(result).reshape(result.shape).T
    for which, (colour, hatch, _) in UNUSABLE.items():
        cells = status == which
        if cells.any():
            shown = np.where(cells, 0.0, np.nan)  # NaN is not drawn
            ax.imshow(shown, cmap=ListedColormap([colour]), interpolation="nearest", **placed)
            if hatch:
                _hatch(ax, x, y, cells, hatch)
    ax.set_xlim(*sorted(_ends(x)))
    ax.set_ylim(*sorted(_ends(y)))
    ax.set_ylabel(y.label, **PLAIN)


def _hatch(ax: Axes, x: SweepAxis, y: SweepAxis, cells: NDArray[np.bool_], hatch: str) -> None:
    """Hatches whole cells: each is given by points just inside its edges, so that contours run between cells."""
    places = [np.add.outer(axis.values, 0.4999 * _step(axis) * np.array([-1, 1])).ravel() for axis in (x, y)]
    doubled = np.repeat(np.repeat(cells, 2, axis=0), 2, axis=1).astype(float)
    ax.contourf(*places, doubled, levels=[0.5, 1.5], colors="none", hatches=[hatch])


def _step(axis: SweepAxis) -> float:
    return float(axis.values[1] - axis.values[0])


def _ends(axis: SweepAxis) -> tuple[float, float]:
    """Outer edges of the first and last cell."""
    return float(axis.values[0]) - _step(axis) / 2, float(axis.values[-1]) + _step(axis) / 2


def _status(result: Sweep) -> NDArray[np.int_]:
    """(K,) status; a bound that is not a number counts as failed."""
    found = result.bounds.status
    return np.where(result.usable | (found == Status.UNSTABLE), found, int(Status.FAILED))


def _bound_mm(result: Sweep) -> Array:
    """(K,) nan where the bound does not hold."""
    return np.where(result.usable, result.bounds.position_m * 1e3, np.nan)


def _caption(result: Sweep) -> str:
    """What is commanded of the tubes that no axis moves."""
    swept = {(axis.kind, axis.tube) for axis in result.axes}
    theta = [
        ("rotation", f"theta_{i + 1} = {v:.6g} deg") for i, v in enumerate(np.degrees(result.theta_commanded).tolist())
    ]
    l = [("translation", f"l_{i + 1} = {v * 1e3:.6g} mm") for i, v in enumerate(result.l_commanded.tolist())]  # noqa: E741
    still = [text for row in (theta, l) for i, (kind, text) in enumerate(row) if (kind, i) not in swept]
    return "at " + ", ".join(still) if still else ""
