"""Contact regions of a wire in a clear tube, Fig. 17."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.shapes import Shape
from ctrplan.reports import looks
from paper_figures.contact_regions import Region, offset_m, regions
from paper_figures.drawing import COLOURS, figure, label, legend, save, table
from paper_figures.pairs import (
    ROBOTS,
    joints,
)


def fig_17() -> str:
    robot = load_robot(ROBOTS / "table_4_pair.toml")
    narrow = load_robot(ROBOTS / "table_4_pair.toml", ["contact.1.clearance_mm=0.8125"])
    clearance_mm = 1e3 * float(robot.clearance_m[0])
    fig, axes = figure(2, 4.0)
    rows = []
    for angle, colour in zip(range(0, 181, 30), COLOURS, strict=True):
        shape = robot.solve(*joints(angle), accuracy="certificate")
        found = regions(shape)
        draw_contact(axes, shape, found, colour, clearance_mm, angle)
        half = regions(narrow.solve(*joints(angle), accuracy="certificate"))
        cells = [f"{1e3 * r.s_m:.1f} mm, {round(_on_tube_deg(shape, r))} deg" for r in found]
        rows.append((f"{angle} deg", *cells, *(f"{1e3 * (f[-1].s_m - f[-2].s_m):.1f} mm" for f in (found, half))))
    axes[0].axhline(clearance_mm, color=looks.MUTED, linestyle="--", linewidth=1.1)
    axes[0].annotate("clearance", (0, clearance_mm), (0, 4), textcoords="offset points", fontsize=8.5)
    label(axes[0], "Fig. 17(a)", "arc length (mm)", "distance of the wire from the wall (mm)")
    label(axes[1], "Fig. 17(b)", "arc length (mm)", "where the wire leans, on the clear tube (deg)")
    axes[0].set(ylim=(-0.3, 1.8), yticks=np.arange(0, 1.7, 0.25))
    axes[1].set(ylim=(-190, 190), yticks=range(-180, 181, 60))
    legend(axes[1], "relative angle", loc="upper left", ncols=3, bbox_to_anchor=(0, 0.93))
    save(fig, "fig_17")
    head = ("relative angle", "proximal contact", "middle contact", "tip contact", "distal arm", "arm at 0.8125 mm")
    return table(head, rows)


def draw_contact(
    axes: Sequence[Axes], shape: Shape, found: Sequence[Region], colour: str, clearance_mm: float, angle: int
) -> None:
    s, offset = offset_m(shape)
    s, offset = s[s >= 0], offset[s >= 0]
    gap = clearance_mm - 1e3 * np.abs(offset)
    lean = _wrapped_deg(np.angle(offset) - np.interp(s, shape.tubes[0].s_m, shape.tubes[0].theta_rad))
    axes[0].plot(1e3 * s, np.maximum(gap, 0), color=colour, linewidth=1.5)
    lean[np.abs(np.diff(lean, append=lean[-1])) > 90] = np.nan
    axes[1].plot(1e3 * s, lean, color=colour, linewidth=1.3, label=f"{angle} deg")
    for r in found:
        row = -0.05 - 0.035 * (angle / 30)
        axes[0].plot(
            [1e3 * r.begin_m - 0.5, 1e3 * r.end_m + 0.5], [row, row], color=colour, lw=2.4, solid_capstyle="butt"
        )
        axes[1].plot(1e3 * r.s_m, _on_tube_deg(shape, r), "o", color=colour, markersize=6)


def _on_tube_deg(shape: Shape, region: Region) -> float:
    outer = shape.tubes[0]
    return float(_wrapped_deg(region.angle_rad - np.interp(region.s_m, outer.s_m, outer.theta_rad)))


def _wrapped_deg(angle_rad: Any) -> Array:
    """In [-175, 185): contacts at 180 deg stay on one side."""
    wrapped: Array = (np.rad2deg(angle_rad) + 175) % 360 - 175
    return wrapped
