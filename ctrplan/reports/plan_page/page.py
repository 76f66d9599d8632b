"""report.html: a plan for people to look at, to question and to keep."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.reports.html_page import Markup, page, plot, section, tag
from ctrplan.reports.plan_curves import (
    direction_panel,
    error_panel,
    margin_panels,
    position_panels,
    speed_panel,
    timeline,
)
from ctrplan.reports.plan_page.panels import CURSOR, stacked_figure
from ctrplan.reports.plan_page.scene import scene_figure
from ctrplan.reports.plan_page.tables import (
    certificate_table,
    leg_table,
    provenance_table,
    reorder_tables,
    target_section,
)
from ctrplan.reports.plan_words.meaning import MEANING
from ctrplan.reports.plan_words.numbers import digits, millimetres
from ctrplan.reports.plan_words.verdict import is_acceptable, verdict
from ctrplan.reports.plan_words.verdict_words import certificate_in_words
from ctrplan.storage.atomic_write import write_atomically

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from ctrplan.planning.plan import Plan
    from ctrplan.reports.plan_scene import PlanScene

# The time of the robot on all curves, as the slider moves.
FOLLOW_SLIDER = f"""
document.getElementById('scene').on('plotly_animatingframe', function (frame) {{
  var time = Number(frame.name);
  ['margins', 'joints'].forEach(function (name) {{
    Plotly.relayout(name, {{'shapes[{CURSOR}].x0': time, 'shapes[{CURSOR}].x1': time}});
  }});
}});
"""
SHADES = "Legs are shaded: rotations blue, translations yellow, simultaneous motions violet."


def write_plan_report(path: str | os.PathLike[str], scene: PlanScene) -> None:
    """Write report.html, one file that loads nothing, whole or not at all; as `write_atomically`."""
    write_atomically(path, plan_report_html(scene))


def plan_report_html(scene: PlanScene) -> str:
    """The content of report.html."""
    plan, scenario = scene.plan, scene.plan.scenario
    return page(
        f"{scenario.name} - ctrplan",
        tag("p", f"Motion plan for {scenario.robot.name}", kind="kicker"),
        tag("h1", scenario.name),
        tag("p", verdict(plan), kind=f"verdict {'good' if is_acceptable(plan) else 'bad'}"),
        _remarks("What is wrong", plan.certificate.problems),
        _tiles(plan),
        _motion(scene),
        section("Certificate", *(tag("p", text) for text in certificate_in_words(plan)), certificate_table(plan)),
        target_section(plan),
        _remarks("Remarks", tuple(dict.fromkeys((*plan.notes, *scenario.warnings)))),
        _errors_and_margins(plan),
        _joints(plan),
        section("Legs", leg_table(plan)),
        section("What reordering changed", *reorder_tables(plan)),
        section("What the error bound means", *(tag("p", text) for text in MEANING)),
        section("Where this comes from", provenance_table(plan)),
    )


def margins_figure(plan: Plan) -> go.Figure:
    """What the certificate found along the path, with what it requires as dashed lines."""
    return stacked_figure([error_panel(plan), direction_panel(plan), *margin_panels(plan)], timeline(plan))


def joints_figure(plan: Plan) -> go.Figure:
    """Joint positions between their limits, and speeds as shares of theirs."""
    return stacked_figure([*position_panels(plan), speed_panel(plan)], timeline(plan))


def _remarks(title: str, texts: Sequence[str]) -> Markup:
    return section(title, tag("ul", *(tag("li", text) for text in texts))) if texts else Markup()


def _tiles(plan: Plan) -> Markup:
    certificate = plan.certificate
    clearance = (millimetres(certificate.min_clearance_m), "smallest clearance beyond the margins")
    if np.isinf(certificate.min_clearance_m):
        clearance = ("free space", "no anatomy to stay clear of")
    shown = [
        (millimetres(certificate.goal_bound_m), "worst-case friction error at the goal"),
        (millimetres(certificate.goal_predicted_m), "predicted friction error at the goal"),
        (millimetres(certificate.worst_bound_m), "worst case at most along the path"),
        clearance,
        (digits(certificate.min_stability), "smallest stability"),
        (f"{digits(plan.trajectory.duration_s)} s", f"duration, {_counted(plan.trajectory.stops, 'stop')} on the way"),
    ]
    return tag(
        "div", *(tag("div", tag("b", value), tag("span", name), kind="tile") for value, name in shown), kind="tiles"
    )


def _motion(scene: PlanScene) -> Markup:
    hint = "Drag to turn, scroll to zoom; a click in the legend hides a part. The time is marked on the curves below."
    figure = plot(scene_figure(scene), "scene", with_library=True, script=FOLLOW_SLIDER)
    return section("The motion", tag("p", hint, kind="quiet"), figure)


def _errors_and_margins(plan: Plan) -> Markup:
    count = len(plan.certificate.samples.joints)
    hint = f"{_counted(count, 'place')} of the path, each solved with the full model. {SHADES}"
    return section(
        "Errors and margins along the path", tag("p", hint, kind="quiet"), plot(margins_figure(plan), "margins")
    )


def _joints(plan: Plan) -> Markup:
    return section("Joints", tag("p", SHADES, kind="quiet"), plot(joints_figure(plan), "joints"))


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"
