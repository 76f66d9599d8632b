"""plan.png: the robot in the anatomy, and beside it what happens on the way, over time."""

from __future__ import annotations

import io
import os
import textwrap
from typing import TYPE_CHECKING, Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from ctrplan.reports import palette
from ctrplan.reports.plan_curves import error_panel, margin_panels, position_panels, speed_panel, timeline
from ctrplan.reports.plan_picture.panels import draw_leg_key, draw_pair, draw_panel
from ctrplan.reports.plan_picture.scene import draw_scene
from ctrplan.reports.plan_words.verdict import COLOURS, standing, verdict
from ctrplan.storage.atomic_write import write_atomically

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan
    from ctrplan.reports.curves import Timeline
    from ctrplan.reports.plan_scene import PlanScene

SIZE_IN, DPI = (16.0, 10.0), 100  # 1600 x 1000 pixels
LEFT, RIGHT = (0.045, 0.46), (0.545, 0.925)  # of the figure's width; beside RIGHT stand the labels of end values
COLUMN_TOP, KEY_BOTTOM = 0.858, 0.884  # of its height


def plan_figure(scene: PlanScene) -> Figure:
    """A figure of 1600 x 1000 pixels: the scene, the margins, the error, joint positions and speeds of its plan.

    Made without pyplot: it has no window, no global state, and is drawn by whatever saves it.
    """
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
    _headline(figure, scene.plan)
    left = figure.add_gridspec(2, 1, left=LEFT[0], right=LEFT[1], top=0.82, bottom=0.06, hspace=0.26)
    left.set_height_ratios((3.8, 1))
    with rc_context({"grid.color": palette.GRID}):  # 3-D axes take it from nowhere else
        draw_scene(figure.add_subplot(left[0], projection="3d", computed_zorder=False), scene)
    time = timeline(scene.plan)
    below = figure.add_subplot(left[1])
    left_margin, right_margin = margin_panels(scene.plan)[:2]
    draw_pair(below, left_margin, right_margin, time)
    below.set_xlabel("time (s)")
    _draw_column(figure, scene.plan, time)
    draw_leg_key(figure, time, (RIGHT[1], KEY_BOTTOM))
    return figure


def write_plan_png(path: str | os.PathLike[str], scene: PlanScene) -> None:
    """Write plan.png, whole or not at all; as `write_atomically`."""
    content = io.BytesIO()
    plan_figure(scene).savefig(content, format="png", dpi=DPI)
    write_atomically(path, content.getvalue())


def _draw_column(figure: Figure, plan: Plan, time: Timeline) -> None:
    """Error, positions and speeds below each other."""
    panels = [error_panel(plan), *position_panels(plan)]
    rows = figure.add_gridspec(
        len(panels) + 1, 1, left=RIGHT[0], right=RIGHT[1], top=COLUMN_TOP, bottom=0.06, hspace=0.42
    )
    axes = [figure.add_subplot(rows[k]) for k in range(rows.nrows)]
    for ax, panel in zip(axes, panels, strict=False):
        draw_panel(ax, panel, time)
    speeds = speed_panel(plan)
    draw_panel(axes[-1], speeds, time, heading=f"{speeds.title}, colours as above, translations dotted")
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels(axes)


def _headline(figure: Figure, plan: Plan) -> None:
    name = textwrap.shorten(plan.scenario.name, 110, placeholder=" ...")
    colour = COLOURS[standing(plan)]
    plain: dict[str, Any] = {"parse_math": False, "va": "top"}
    figure.text(0.018, 0.98, name, fontsize=18, fontweight="bold", color=palette.INK, **plain)
    sentence = "\n".join(textwrap.wrap(verdict(plan), 170)[:2])
    figure.text(0.018, 0.944, sentence, fontsize=12, color=colour, **plain)
