"""Section IV-A: clearance, Figs. 4 and 5, and friction, Figs. 6 and 7."""

from __future__ import annotations

from functools import cache

import numpy as np

from ctrplan.reports import looks
from paper_figures.drawing import COLOURS, figure, label, legend, points, save, table
from paper_figures.pairs import (
    CLEARANCES_MM,
    FRICTIONS,
    OUTER_LENGTH_M,
    apart_mm,
    exact,
    joints,
    opposed,
    pair,
    turned,
)


def fig_4_5() -> str:
    fig, axes = figure(2)
    rows = []
    for clearance, colour in zip(CLEARANCES_MM, COLOURS, strict=False):
        known = exact("deviation_from_zero_clearance", clearance_m=1e-3 * clearance)
        at = {angle: deviation_mm(clearance, angle) for angle in np.arange(0, 180.1, 5)}
        for ax, angles in zip(axes, (np.arange(0, 180.1, 5), np.arange(0, 20.1, 0.5)), strict=True):
            ax.plot(angles, [deviation_mm(clearance, a) for a in angles], color=colour, label=f"{clearance:g} mm")
            shown = [row for row in known if row["base_angle_deg"] <= angles[-1]]
            points(ax, [r["base_angle_deg"] for r in shown], [1e3 * r["deviation_m"] for r in shown], colour)
        worst = max(at, key=lambda angle: at[angle])
        errors = [apart_mm(turned(clearance, row["base_angle_deg"]).tip_m, row["tip_m"]) for row in known]
        error = f"{max(errors):.3f} mm" if errors else ""
        rows.append((f"{clearance:g} mm", f"{at[worst]:.2f} mm at {worst:g} deg", f"{at[180]:.2f} mm", error))
    label(axes[0], "Fig. 4", "base angle (deg)", "tip difference (mm)")
    label(axes[1], "Fig. 5, small angles", "base angle (deg)", "tip difference (mm)")
    axes[0].set(xticks=range(0, 181, 30), ylim=(0, 7))
    axes[1].set(xticks=range(0, 21, 5), ylim=(0, 1.8))
    legend(axes[0], "clearance", checked=True)
    save(fig, "fig_4_5")
    return table(("clearance", "largest difference", "at 180 deg", "largest tip error against exact"), rows)


@cache
def deviation_mm(clearance_mm: float, angle: float) -> float:
    zero = pair(clearance_mm).zero_clearance(*joints(angle))
    return apart_mm(turned(clearance_mm, angle).tip_m, zero.tip_m)


def fig_6_7() -> str:
    fig, axes = figure(2)
    straight = (0, 0, OUTER_LENGTH_M)
    smooth = np.geomspace(0.01, 3, 40)
    for mu, colour in zip(FRICTIONS, COLOURS, strict=False):
        axes[0].plot(smooth, [apart_mm(opposed(c, mu).tip_m, straight) for c in smooth], color=colour, label=f"{mu:g}")
        known = exact("friction_at_180_deg", mu=mu)
        points(axes[0], [1e3 * r["clearance_m"] for r in known], [1e3 * r["deviation_m"] for r in known], colour)
    axes[0].set(xscale="log", ylim=(0, None), xticks=CLEARANCES_MM, xticklabels=[f"{c:g}" for c in CLEARANCES_MM])
    axes[0].minorticks_off()
    label(axes[0], "Fig. 6, base angle 180 deg", "clearance (mm)", "tip difference (mm)")
    legend(axes[0], "friction coefficient", checked=True)
    shares = np.linspace(-0.5, 0.5, 41)
    for clearance, colour in zip(CLEARANCES_MM, COLOURS, strict=False):
        tips = np.array([1e3 * opposed(clearance, abs(m), phi=np.sign(m)).tip_m for m in shares])
        axes[1].plot(tips[:, 1], tips[:, 0], color=colour, label=f"{clearance:g} mm")
        known = exact("friction_at_180_deg", clearance_m=1e-3 * clearance)
        points(axes[1], [1e3 * r["tip_m"][1] for r in known], [1e3 * r["tip_m"][0] for r in known], colour)
    label(axes[1], "Fig. 7, friction coefficient 0 to 0.5 either way", "tip y (mm)", "tip x (mm)")
    axes[1].plot(0, 0, "+", color=looks.INK, markersize=9)
    axes[1].annotate("zero clearance", (0, 0), (6, -1), textcoords="offset points", fontsize=8.5, color=looks.INK)
    axes[1].set_ylim(-0.4, 7.6)
    legend(axes[1], "clearance", ncols=3, loc="upper center", checked=True)
    save(fig, "fig_6_7")
    rows = [(f"{c:g} mm", *(_beside(c, mu) for mu in FRICTIONS), _share(c)) for c in CLEARANCES_MM]
    return table(("clearance", *(f"mu = {mu:g}" for mu in FRICTIONS), "tip error, % of the difference"), rows)


def _beside(clearance: float, mu: float) -> str:
    (known,) = exact("friction_at_180_deg", clearance_m=1e-3 * clearance, mu=mu)
    return f"{apart_mm(opposed(clearance, mu).tip_m, (0, 0, 0.15)):.2f} ({1e3 * known['deviation_m']:.2f})"


def _share(clearance: float) -> str:
    known = exact("friction_at_180_deg", clearance_m=1e-3 * clearance)
    errors = [apart_mm(opposed(clearance, row["mu"]).tip_m, row["tip_m"]) / row["deviation_m"] for row in known]
    return f"{0.1 * max(errors):.1f}"
