"""Section IV-C: contact forces, Figs. 10 to 13."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ctrplan.reports import looks
from paper_figures.contact_regions import Region, couple, regions
from paper_figures.drawing import COLOURS, figure, label, legend, save, table
from paper_figures.pairs import (
    CLEARANCES_MM,
    FRICTIONS,
    exact,
    opposed,
    turned,
)


def stems(ax: Axes, found: Sequence[Region], colour: str, name: str, mu: float = 0.0) -> None:
    """A stem per contact region at its centroid, as high as normal force and friction together."""
    for k, r in enumerate(found):
        at, force = 1e3 * r.s_m, float(np.hypot(1, mu)) * r.force_N
        ax.plot([at, at], [0, force], color=colour, linewidth=1.4)
        ax.plot(at, force, "o", color=colour, markersize=5, label=name if k == 0 else None)


def fig_10_13() -> str:
    fig, axes = figure(2)
    for clearance, colour in zip(CLEARANCES_MM, COLOURS, strict=False):
        stems(axes[0], [r for r in regions(opposed(clearance)) if r.s_m > 0.08], colour, f"{clearance:g} mm")
    axes[0].set(yscale="log", ylim=(4, 200), yticks=(5, 10, 20, 50, 100), yticklabels=("5", "10", "20", "50", "100"))
    axes[0].minorticks_off()
    label(axes[0], "Fig. 10, base angle 180 deg, no friction", "arc length (mm)", "force of a contact region (N)")
    legend(axes[0], "clearance", loc="upper left")
    for k, mu in enumerate((0.0, 0.2, 0.5)):
        found = [r for r in regions(opposed(0.05, mu)) if r.s_m > 0.1]
        stems(axes[1], found, COLOURS[k], f"{mu:g}", mu)
    axes[1].set(ylim=(44, 52), xlim=(141, 151))
    label(axes[1], "Fig. 13, clearance 0.05 mm", "arc length (mm)", "force, normal and friction (N)")
    legend(axes[1], "friction coefficient", loc="upper center")
    save(fig, "fig_10_13")
    rows = []
    for clearance in CLEARANCES_MM:
        (known,) = exact("couple_at_180_deg", clearance_m=1e-3 * clearance, transmission_m=0.017)
        mine = couple(opposed(clearance))
        given = known["tip_force_N"], known["arm_m"], known["couple_Nm"]
        force, arm, moment = zip(mine, given, strict=True)
        cells = ("{:.1f} ({:.1f})".format(*force), "{:.1f} ({:.1f})".format(*np.multiply(1e3, arm)))
        rows.append((f"{clearance:g} mm", *cells, "{:.3f} ({:.3f})".format(*moment)))
    return table(("clearance", "tip force, N", "arm, mm", "couple, N m"), rows)


def fig_13() -> str:
    rows = []
    for mu in FRICTIONS:
        shape = opposed(0.05, mu)
        middle, tip = regions(shape)[-2:]
        twist = shape.tubes[1].theta_rad[-1] - shape.tubes[0].theta_rad[-1]
        forces = [f"{np.hypot(1, mu) * r.force_N:.1f} ({r.force_N:.1f})" for r in (tip, middle)]
        rows.append((f"{mu:g}", *forces, f"{np.rad2deg(twist):.1f}"))
    head = ("mu", "at the tip, N, with friction (normal alone)", "opposite, N", "relative angle at the tips, deg")
    return table(head, rows)


def fig_11_12() -> str:
    fig, axes = figure(2)
    angles = (30, 60, 90, 120, 150, 180)
    for angle in (60, 120, 180):
        colour = COLOURS[angles.index(angle)]
        shape = turned(0.05, angle)
        half = np.deg2rad(angle) / 2  # the plane a balanced pair bends in
        along, across = 1e3 * shape.centreline_m[:, 2], 1e3 * shape.centreline_m[:, :2] @ [np.cos(half), np.sin(half)]
        axes[0].plot(along, across, color=colour, linewidth=1.8, label=f"{angle} deg")
        for r in regions(shape):
            at = [np.interp(r.s_m, shape.s_m, values) for values in (along, across)]
            axes[0].plot(*at, "o", markersize=0.45 * r.force_N, color=looks.SERIES[2], alpha=0.55, markeredgewidth=0)
    axes[0].set_xlim(-22, 165)
    axes[0].set_aspect("equal", adjustable="datalim")
    label(axes[0], "Fig. 11, diameter in proportion to the force", "z (mm)", "in the bending plane (mm)")
    legend(axes[0], "base angle", loc="upper left")
    rows = []
    for angle, colour in zip(angles, COLOURS, strict=False):
        found = regions(turned(0.05, angle))
        stems(axes[1], found, colour, f"{angle} deg")
        rows.append((f"{angle} deg", *(f"{r.force_N:.1f} N at {1e3 * r.s_m:.1f} mm" for r in found)))
    axes[1].set(ylim=(0, 55), xlim=(-3, 156))
    label(axes[1], "Fig. 12, clearance 0.05 mm, no friction", "arc length (mm)", "force of a contact region (N)")
    legend(axes[1], "base angle", loc="upper center")
    save(fig, "fig_11_12")
    return table(("base angle", "near the base", "before the tip", "tip"), rows)
