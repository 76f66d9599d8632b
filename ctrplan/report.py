"""report.html: a plan for people to look at, to question and to keep."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

import ctrplan
from ctrplan.export import write_atomically
from ctrplan.html_page import Markup, escaped, facts, lines, page, plot, section, table, tag
from ctrplan.plan_timing import leg_end_s
from ctrplan.report_curves import CURSOR, joints_figure, margins_figure
from ctrplan.report_scene import scene_figure
from ctrplan.verdict import digits, findings, is_acceptable, millimetres, verdict

if TYPE_CHECKING:
    from ctrplan.drive import Array
    from ctrplan.planning.plan import Plan

# The time of the robot on all curves, as the slider moves.
FOLLOW_SLIDER = f"""
document.getElementById('scene').on('plotly_animatingframe', function (frame) {{
  var time = Number(frame.name);
  ['margins', 'joints'].forEach(function (name) {{
    Plotly.relayout(name, {{'shapes[{CURSOR}].x0': time, 'shapes[{CURSOR}].x1': time}});
  }});
}});
"""
MEANING = (
    "Friction between the tubes makes the robot's shape depend on how it got there: the same joint values can give many "
    "shapes. At every sampled place of the path the model was solved without friction, and with friction at its Coulomb "
    "limit in every combination of directions (the corner shapes). The worst-case friction error is the largest distance "
    "of the tip between a corner shape and the shape without friction; the envelope is the same distance all along the "
    "robot, with the radius of the tubes added. Clearance, stability and strain were checked for all of these shapes.",
    "What it does not cover: the model is quasi-static (slow motion, no vibration), friction follows Coulomb's law with "
    "the coefficients of the robot file, and nothing touches the robot from outside, neither anatomy nor tools nor "
    "gravity. The figures hold for the model as calibrated; what calibration left unexplained is in the robot file's "
    "model error and nowhere else. That the corner shapes enclose every history of motion is an established observation, "
    "not a theorem.",
)


def write_report(path: str | os.PathLike[str], plan: Plan) -> None:
    """Write report.html, whole or not at all; as `write_atomically`."""
    write_atomically(path, report_html(plan))
