"""Pictures over the rows of a path, a log or a sweep: tip errors, friction states, bounds."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
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
from ctrplan.reports import looks
from ctrplan.studies.follow import Following
from ctrplan.studies.simulate import Simulation
from ctrplan.studies.sweep import Sweep, SweepAxis

SIZE_IN = (11.0, 7.5)


def stacked(title: str, pairs: int, xlabel: str, heights: Sequence[float]) -> tuple[Figure, Axes, Axes | None]:
    """A figure with axes for errors, and for friction states where there are pairs; of relative heights."""
    figure = Figure(figsize=SIZE_IN, dpi=looks.DPI, facecolor="white", layout="constrained")
    count = 2 if pairs else 1
    axes = figure.subplots(count, 1, sharex=True, squeeze=False, height_ratios=heights[:count])[:, 0]
    axes[0].set_title(title, loc="left", fontsize=14, fontweight="bold", color=looks.INK, parse_math=False)
    axes[-1].set_xlabel(xlabel)
    for ax in axes:
        _open_axes(ax)
    return figure, axes[0], axes[1] if pairs else None


def _open_axes(ax: Axes) -> None:
    """A grid behind the curves, no frame above and at the right."""
    ax.grid(color=looks.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def label_errors(ax: Axes, label: str) -> None:
    """What errors over rows have in common, once they are drawn."""
    ax.margins(x=0.01)
    ax.set_ylim(bottom=0)
    ax.set_ylabel(label)
    ax.legend(frameon=False)


def draw_friction(ax: Axes, rows: Sequence[Array], states: Sequence[Array]) -> None:
    """Friction states (K, pairs) over rows (K,), one after the other where a path has several runs."""
    for run, (row, phi) in enumerate(zip(rows, states, strict=True)):
        for pair in range(phi.shape[1]):
            label = f"tubes {pair + 1} and {pair + 2}" if run == 0 else None
            ax.plot(row, phi[:, pair], color=looks.tube_colour(pair), label=label)
    ax.margins(x=0.01)
    ax.set_ylim(-1.05, 1.05)
    ax.set_ylabel("friction state")
    ax.legend(frameon=False, ncols=3)


def following_figure(result: Following) -> Figure:
    """One-step-ahead errors above, friction states of the pairs below, over the rows. Made without pyplot."""
    figure, errors, friction = stacked(result.robot.name, result.robot.n - 1, "row of the log", (1, 1))
    row = np.asarray(result.data.rows + 1, dtype=np.float64)
    _draw_errors(errors, row, result)
    if friction:
        draw_friction(friction, [row], [result.friction])
    return figure


def _draw_errors(ax: Axes, row: Array, result: Following) -> None:
    half_mm = np.linalg.norm(result.high_m - result.low_m, axis=1) / 2 * 1e3
    ax.fill_between(row, half_mm, color=looks.MET, alpha=0.15, linewidth=0, label="half of the observer's interval")
    ax.plot(row, result.error_without_m * 1e3, color=looks.MUTED, linewidth=1.5, label="without an observer")
    ax.plot(row, result.error_m * 1e3, color=looks.MET, linewidth=1.5, label="with the observer, one step ahead")
    label_errors(ax, "measured tip from the expected one (mm)")


MOST_MARKERS = 60  # more points of a curve are not marked


def simulation_figure(result: Simulation) -> Figure:
    """Tip deviation and bound above, friction states of the pairs below, over the waypoints. Made without pyplot."""
    figure, deviation, friction = stacked(result.robot.name, result.robot.n - 1, "row of the path", (2, 1))
    _draw_deviation(deviation, result)
    if friction:
        runs = [_samples_of(result, run) for run in result.path.runs]
        draw_friction(friction, [result.place[rows] + 1 for rows in runs], [result.phi[rows] for rows in runs])
    return figure


def _draw_deviation(ax: Axes, result: Simulation) -> None:
    row, deviation_mm, bound_mm = result.place + 1, result.deviation_m * 1e3, result.bounds.position_m * 1e3
    unstable = result.bounds.status == Status.UNSTABLE
    for run in result.path.runs:
        rows = _samples_of(result, run)
        names = ("worst-case bound", "predicted tip deviation") if run.start == 0 else (None, None)
        bound = np.where(unstable, np.nan, bound_mm)[rows]
        ax.fill_between(row[rows], bound, color=looks.BOUND, alpha=0.15, linewidth=0, label=names[0])
        ax.plot(row[rows], deviation_mm[rows], color=looks.BOUND, linewidth=2, label=names[1])
    at = result.waypoints
    if len(at) <= MOST_MARKERS:
        ax.plot(row[at], deviation_mm[at], "o", color=looks.BOUND, markersize=4)
    snapped = np.flatnonzero(result.snaps)
    if len(snapped):
        ax.plot(row[snapped], deviation_mm[snapped], "v", color=looks.LIMIT, markersize=9, label="snap")
    label_errors(ax, "tip from the frictionless solution (mm)")


def _samples_of(result: Simulation, run: slice) -> NDArray[np.bool_]:
    """(S,) which samples are of a run."""
    return np.asarray((result.place >= run.start) & (result.place <= run.stop - 1))


SWEEP_SIZE_IN = (10.0, 7.0)
BOUND_LABEL = "worst-case friction error of the tip (mm)"
WIDEST_CAPTION, WIDEST_NAME = (
    110,
    70,
)  # letters across the figure; wider ones leave the axes no room
PLAIN: dict[str, Any] = {"parse_math": False}
UNUSABLE = {  # status -> colour, hatch, words
    Status.UNSTABLE: (looks.UNSTABLE, "///", "unstable: the robot would snap"),
    Status.FAILED: (looks.FAILED, "", "failed: no bound is promised"),
}


def sweep_figure(result: Sweep) -> Figure:
    """The bound over the axes; where there is none, grey says why. Made without pyplot, no global state."""
    figure = Figure(figsize=SWEEP_SIZE_IN, dpi=looks.DPI, facecolor="white", layout="constrained")
    ax = figure.add_subplot()
    caption = textwrap.wrap(_caption(result), WIDEST_CAPTION)
    name, pad = textwrap.shorten(result.robot.name, WIDEST_NAME, placeholder=" ..."), 12 + 14 * max(1, len(caption))
    ax.set_title(name, loc="left", fontsize=14, fontweight="bold", color=looks.INK, pad=pad, **PLAIN)
    ax.text(0, 1.02, "\n".join(caption), transform=ax.transAxes, color=looks.MUTED, fontsize=10)
    ax.set_xlabel(result.axes[0].label, **PLAIN)
    (_draw_curve if len(result.axes) == 1 else _draw_map)(ax, result)
    shown = [status for status in UNUSABLE if status in _status(result)]
    patches = [Patch(facecolor=UNUSABLE[s][0], hatch=UNUSABLE[s][1], edgecolor=looks.MUTED) for s in shown]
    if shown:
        figure.legend(patches, [UNUSABLE[s][2] for s in shown], loc="outside lower left", frameon=False, ncols=2)
    return figure


def sweep_png(result: Sweep) -> bytes:
    """The figure as a PNG file's content."""
    with rc_context({"hatch.linewidth": 0.6, "hatch.color": looks.MUTED}):
        return looks.png(sweep_figure(result))


def _draw_curve(ax: Axes, result: Sweep) -> None:
    axis, status = result.axes[0], _status(result)
    marker = "o" if len(axis.values) <= MOST_MARKERS else ""
    ax.plot(axis.values, _bound_mm(result), color=looks.BOUND, linewidth=2, marker=marker, markersize=4)
    starts = np.flatnonzero(np.diff(status, prepend=-1))
    half = (axis.values[1] - axis.values[0]) / 2
    for first, end in zip(starts.tolist(), [*starts[1:].tolist(), len(status)], strict=True):
        if status[first] in UNUSABLE:
            colour, hatch, _ = UNUSABLE[Status(status[first])]
            edges = axis.values[first] - half, axis.values[end - 1] + half
            ax.axvspan(*edges, facecolor=colour, hatch=hatch, edgecolor=looks.MUTED, linewidth=0, zorder=0)
    ax.set_xlim(*sorted(axis.values[[0, -1]]))
    ax.set_ylim(bottom=0)
    ax.set_ylabel(BOUND_LABEL)
    _open_axes(ax)


def _draw_map(ax: Axes, result: Sweep) -> None:
    x, y = result.axes
    placed: dict[str, Any] = {"extent": (*_ends(x), *_ends(y)), "origin": "lower", "aspect": "auto"}
    bound_mm = _bound_mm(result).reshape(result.shape).T
    if result.usable.any():
        image = ax.imshow(bound_mm, cmap=looks.HEAT, vmin=0, **placed)
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
    outcome = result.bounds.status
    return np.where(result.usable | (outcome == Status.UNSTABLE), outcome, int(Status.FAILED))


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
