"""report.html: a plan for people to look at, to question and to keep."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.version import __version__
from ctrplan.planning.plan_timing import leg_end_s
from ctrplan.reports.html_page import Markup, escaped, facts, lines, page, plot, section, table, tag
from ctrplan.reports.plan_page.curves import CURSOR, joints_figure, margins_figure
from ctrplan.reports.plan_page.scene import scene_figure
from ctrplan.reports.plan_words.verdict import digits, findings, is_acceptable, millimetres, verdict
from ctrplan.reports.plan_words.verdict_words import certificate_in_words
from ctrplan.storage.atomic_write import write_atomically

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
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
SHADES = "Legs are shaded: rotations blue, translations yellow, simultaneous motions violet."
MEANING = (
    "Friction between the tubes makes the robot's shape depend on how it got there: the same joint values can "
    "give many shapes. At every sampled place of the path the model was solved without friction, and with "
    "friction at its Coulomb limit in every combination of directions (the corner shapes). The worst-case "
    "friction error is the largest distance of the tip in a corner shape from the tip without friction. The "
    "envelope is that distance all along the robot, with the tubes' radius and the model error added; the "
    "clearance is the smallest of all these shapes.",
    "The predicted friction error follows the contacts' slip along this very path, from every friction state that the "
    "robot may start in (released, and every corner); the largest counts. Rotations load friction, translations "
    "release it, so that it is usually far below the worst case where a plan ends with a translation.",
    "What the figures do not cover: the model is quasi-static (slow motion, no vibration), friction follows "
    "Coulomb's law with the coefficients of the robot file, and nothing touches the robot from outside, neither "
    "anatomy nor tools. They hold for the model as calibrated; what calibration could not explain is in the robot "
    "file's model error and nowhere else. That no history of motion leads beyond the corner shapes is supported "
    "by trials, not proved.",
)


def write_report(path: str | os.PathLike[str], plan: Plan) -> None:
    """Write report.html, one file that loads nothing, whole or not at all; as `write_atomically`."""
    write_atomically(path, report_html(plan))


def report_html(plan: Plan) -> str:
    """The content of report.html."""
    scenario = plan.scenario
    return page(
        f"{scenario.name} - ctrplan",
        tag("p", f"Motion plan for {scenario.robot.name}", kind="kicker"),
        tag("h1", scenario.name),
        tag("p", verdict(plan), kind=f"verdict {'good' if is_acceptable(plan) else 'bad'}"),
        _remarks("What is wrong", plan.certificate.problems),
        _tiles(plan),
        _scene(plan),
        section("Certificate", *(tag("p", text) for text in certificate_in_words(plan)), _certificate(plan)),
        _targets(plan),
        _remarks("Remarks", tuple(dict.fromkeys((*plan.notes, *scenario.warnings)))),
        _margins(plan),
        _joints(plan),
        section("Legs", _legs(plan)),
        section("What reordering changed", *_reorder(plan)),
        section("What the error bound means", *(tag("p", text) for text in MEANING)),
        section("Where this comes from", _provenance(plan)),
    )


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


def _scene(plan: Plan) -> Markup:
    hint = "Drag to turn, scroll to zoom; a click in the legend hides a part. The time is marked on the curves below."
    figure = plot(scene_figure(plan), "scene", with_library=True, script=FOLLOW_SLIDER)
    return section("The motion", tag("p", hint, kind="quiet"), figure)


def _margins(plan: Plan) -> Markup:
    count = len(plan.certificate.samples.joints)
    hint = f"{_counted(count, 'place')} of the path, each solved with the full model. {SHADES}"
    return section(
        "Errors and margins along the path", tag("p", hint, kind="quiet"), plot(margins_figure(plan), "margins")
    )


def _joints(plan: Plan) -> Markup:
    return section("Joints", tag("p", SHADES, kind="quiet"), plot(joints_figure(plan), "joints"))


def _certificate(plan: Plan) -> Markup:
    status = {True: tag("span", "✓ met", kind="good"), False: tag("span", "✗ not met", kind="bad"), None: escaped("")}
    rows = ((f.quantity, f.value, f.requirement, status[f.met]) for f in findings(plan))
    return table(("Quantity", "Value", "Required", "Status"), rows)


def _targets(plan: Plan) -> Markup:
    """Each of several targets; nothing where there is one."""
    if not plan.scenario.via:
        return Markup()
    ends = leg_end_s(plan)
    rows = (
        (
            f"{number}{f', {target.name}' if target.name else ''}",
            f"{ends[target.leg]:.2f} s",
            millimetres(target.tip_error_m),
            millimetres(target.bound_m),
        )
        for number, target in enumerate(plan.certificate.targets, start=1)
    )
    header = ("Target", "Reached at", "Distance without friction", "Worst-case friction error")
    return section("Targets", table(header, rows))


def _legs(plan: Plan) -> Markup:
    ends = leg_end_s(plan)
    starts = np.concatenate([[0.0], ends[:-1]])
    rows = (
        (str(k), leg.kind, f"{start:.2f} to {end:.2f} s", lines(_moves(plan, leg.start, leg.end)))
        for k, (leg, start, end) in enumerate(zip(plan.legs, starts, ends, strict=True), start=1)
    )
    return table(("Leg", "Kind", "Time", "What moves"), rows)


def _moves(plan: Plan, start: Array, end: Array) -> Iterator[str]:
    for joint, a, b in zip(plan.scenario.robot.drive.joints, start, end, strict=True):
        if a != b:
            unit = "°" if joint.unit == "deg" else f" {joint.unit}"
            yield f"{joint.name}: {a / joint.si_per_unit:.2f}{unit} → {b / joint.si_per_unit:.2f}{unit}"


def _reorder(plan: Plan) -> tuple[Markup, Markup, Markup]:
    report = plan.reorder
    rows = [
        ("Cost", f"{digits(report.cost_before_mm)} mm", f"{digits(report.cost_after_mm)} mm"),
        (
            "Worst-case friction error at the goal",
            millimetres(report.goal_bound_before_m),
            millimetres(report.goal_bound_after_m),
        ),
        (
            "Error summed over the path",
            f"{digits(report.error_integral_before_mm)} mm",
            f"{digits(report.error_integral_after_mm)} mm",
        ),
        ("Stops on the way", str(report.stops_before), str(report.stops_after)),
    ]
    others = (
        (other.name, millimetres(other.goal_predicted_m), f"{digits(other.length_mm)} mm", other.problem or "valid")
        for other in report.alternatives
    )
    head = ("Way to the goal", "Predicted friction error there", "Joint length", "Validity")
    changes = tag("ul", *(tag("li", change) for change in report.changes))
    return changes, table(("Quantity", "Before", "After"), rows), table(head, others)


def _provenance(plan: Plan) -> Markup:
    scenario, robot = plan.scenario, plan.scenario.robot
    return facts(
        [
            ("Scenario", f"{scenario.name}, {scenario.path or 'not from a file'}"),
            ("SHA-256 of the scenario", tag("code", scenario.sha256)),
            ("Robot", f"{robot.name}, {robot.path or 'not from a file'}"),
            ("SHA-256 of the robot", tag("code", robot.sha256)),
            ("Planner", f"{plan.planner}, {plan.style}, seed {plan.seed}"),
            ("Search", f"{digits(plan.search_time_s)} s, first certified path at {digits(plan.first_certified_s)} s"),
            ("Search ended by", plan.ended_by),
            ("ctrplan", __version__),
        ]
    )


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"
