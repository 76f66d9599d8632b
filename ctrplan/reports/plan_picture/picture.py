"""plan.png: the robot in the anatomy, and beside it what happens on the way, over time."""

from __future__ import annotations

import io
import os
import textwrap
from typing import TYPE_CHECKING, Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from ctrplan.drive.drive import UNITS
from ctrplan.reports import palette
from ctrplan.reports.plan_picture.curves import draw_bound, draw_margins, draw_positions, draw_velocities
from ctrplan.reports.plan_picture.scene import draw_scene
from ctrplan.reports.plan_words.verdict import is_acceptable, verdict
from ctrplan.storage.atomic_write import write_atomically

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan

SIZE_IN, DPI = (16.0, 10.0), 100  # 1600 x 1000 pixels
LEFT, RIGHT = (0.045, 0.46), (0.545, 0.925)  # of the figure's width; beside RIGHT stand the labels of end values


def plan_figure(plan: Plan) -> Figure:
    """A figure of 1600 x 1000 pixels: scene, margins, error bound, joint positions and velocities of the plan.

    Made without pyplot: it has no window, no global state, and is drawn by whatever saves it.
    """
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
    _headline(figure, plan)
    left = figure.add_gridspec(2, 1, left=LEFT[0], right=LEFT[1], top=0.82, bottom=0.06, hspace=0.26)
    left.set_height_ratios((3.8, 1))
    kinds = [kind for kind in UNITS if any(joint.kind == kind for joint in plan.scenario.robot.drive.joints)]
    right = figure.add_gridspec(2 + len(kinds), 1, left=RIGHT[0], right=RIGHT[1], top=0.87, bottom=0.06, hspace=0.42)
    with rc_context({"grid.color": palette.GRID}):  # 3-D axes take it from nowhere else
        draw_scene(figure.add_subplot(left[0], projection="3d", computed_zorder=False), plan)
    draw_margins(figure.add_subplot(left[1]), plan)
    axes = [figure.add_subplot(right[row]) for row in range(right.nrows)]
    draw_bound(axes[0], plan)
    for ax, kind in zip(axes[1:], kinds, strict=False):
        draw_positions(ax, plan, kind)
    draw_velocities(axes[-1], plan)
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels(axes)
    return figure


def write_plan_png(path: str | os.PathLike[str], plan: Plan) -> None:
    """Write plan.png, whole or not at all; as `write_atomically`."""
    content = io.BytesIO()
    plan_figure(plan).savefig(content, format="png", dpi=DPI)
    write_atomically(path, content.getvalue())


def _headline(figure: Figure, plan: Plan) -> None:
    name = textwrap.shorten(plan.scenario.name, 110, placeholder=" ...")
    colour = palette.MET if is_acceptable(plan) else palette.LIMIT
    plain: dict[str, Any] = {"parse_math": False, "va": "top"}
    figure.text(0.018, 0.98, name, fontsize=18, fontweight="bold", color=palette.INK, **plain)
    sentence = "\n".join(textwrap.wrap(verdict(plan), 200)[:2])
    figure.text(0.018, 0.944, sentence, fontsize=12, color=colour, **plain)
