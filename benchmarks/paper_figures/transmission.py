"""Section IV-B: collars and transmission lengths, Figs. 8 and 9."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ctrplan.mechanics.shapes import Status
from ctrplan.reports import looks
from paper_figures.drawing import COLOURS, figure, label, legend, points, save, table
from paper_figures.pairs import (
    CLEARANCES_MM,
    OUTER_LENGTH_M,
    SMALL_MM,
    TRANSMISSION_MM,
    apart_mm,
    exact,
    joints,
    opposed,
    pair,
)


def fig_8() -> str:
    fig, axes = figure(2, 3.0)
    rows = []
    for ax, length, title in zip(axes, (SMALL_MM, TRANSMISSION_MM), ("(a) no", "(b) 17 mm"), strict=True):
        shape = opposed(3, 0, length)
        for tube, colour, name in zip(shape.tubes, (looks.START, looks.INK), ("outer", "inner"), strict=True):
            curve = CubicHermiteSpline(tube.s_m, tube.centreline_m, tube.frames[:, :, 2])
            x, _, z = 1e3 * curve(np.linspace(tube.s_m[0], tube.s_m[-1], 400)).T
            ax.plot(z, x, color=colour, linewidth=2, label=name)
        outer, inner = (1e3 * tube.centreline_m[-1, 0] for tube in shape.tubes)
        label(ax, f"Fig. 8{title} transmission, clearance 3 mm", "z (mm)", "x (mm)")
        ax.axhline(0, color=looks.MUTED, linewidth=0.8)
        rows.append((f"{round(length):d} mm", f"{outer:.2f} mm", f"{inner:.2f} mm", f"{abs(outer + inner) / 2:.2f} mm"))
    for ax in axes:
        ax.set(ylim=(-3.4, 9), xlim=(-20, 155))
    legend(axes[0], "tube", loc="upper left")
    save(fig, "fig_8")
    return table(("transmission", "outer tip x", "inner tip x", "mean"), rows)


def fig_9() -> str:
    fig, (ax,) = figure(1)
    lengths = np.concatenate([[SMALL_MM], np.arange(0.5, 20, 0.5), np.arange(20, 260.1, 5)])
    rows = []
    shown = (0.0, 5.0, 17.0, 50.0, 100.0)
    for clearance, colour in zip(CLEARANCES_MM, COLOURS, strict=False):
        shapes = [opposed(clearance, 0, length) for length in lengths]
        stable = [shape.status is Status.CONVERGED for shape in shapes]
        count = stable.index(False) if False in stable else len(stable)
        far = [apart_mm(shape.tip_m, (0, 0, OUTER_LENGTH_M)) for shape in shapes[:count]]
        ax.plot(lengths[:count], far, color=colour, label=f"{clearance:g} mm")
        known = exact("transmission_at_180_deg", clearance_m=1e-3 * clearance)
        points(ax, [1e3 * r["transmission_m"] for r in known], [1e3 * r["deviation_m"] for r in known], colour)
        cells = [f"{np.interp(max(t, SMALL_MM), lengths[:count], far):.2f} ({_known_mm(known, t):.2f})" for t in shown]
        rows.append((f"{clearance:g} mm", *cells, f"{lengths[count - 1]:g} mm"))
    limit = zero_clearance_limit_mm()
    ax.axvline(limit, color=looks.LIMIT, linestyle="--", linewidth=1.1)
    ax.annotate("zero-clearance pair\nunstable beyond", (limit, 11.8), (6, 0), textcoords="offset points",
                fontsize=8.5, color=looks.LIMIT)  # fmt: skip
    label(ax, "Fig. 9, base angle 180 deg", "transmission length (mm)", "tip difference (mm)")
    ax.set(ylim=(0, 13.5), xlim=(-5, 230))
    legend(ax, "clearance", checked=True)
    save(fig, "fig_9")
    return table(("clearance", *(f"{t:g} mm" for t in shown), "stable up to"), rows)


def _known_mm(known: list[dict[str, Any]], transmission_mm: float) -> float:
    return next(1e3 * float(r["deviation_m"]) for r in known if np.isclose(1e3 * r["transmission_m"], transmission_mm))


def zero_clearance_limit_mm() -> float:
    """Longest transmission at which the zero-clearance pair is stable at 180 deg."""
    low, high = TRANSMISSION_MM, 1000.0
    while high - low > 0.1:
        middle = (low + high) / 2
        shape = pair(0.05, 0.0, middle).zero_clearance(*joints(180, middle))
        low, high = (middle, high) if shape.status is Status.CONVERGED else (low, middle)
    return low
