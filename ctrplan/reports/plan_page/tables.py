"""The tables of report.html: certificate, targets, legs, reordering, and where the plan comes from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.version import __version__
from ctrplan.planning.plan_timing import leg_end_s
from ctrplan.reports.html_page import Markup, escaped, facts, lines, section, table, tag
from ctrplan.reports.plan_page.other_ways import ways_table
from ctrplan.reports.plan_words.certificate_rows import CertificateRow, certificate_rows
from ctrplan.reports.plan_words.numbers import digits, millimetres

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.planning.plan import Plan


def certificate_table(plan: Plan) -> Markup:
    """Every quantity of the certificate with what is required of it."""
    rows = ((row.quantity, row.value, row.requirement, _status(row)) for row in certificate_rows(plan))
    return table(("Quantity", "Value", "Required", "Status"), rows)


def _status(row: CertificateRow) -> Markup:
    if row.caution:
        return tag("span", "! beyond it", kind="caution")
    texts = {True: tag("span", "✓ met", kind="good"), False: tag("span", "✗ not met", kind="bad"), None: escaped("")}
    return texts[row.met]


def target_section(plan: Plan) -> Markup:
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


def leg_table(plan: Plan) -> Markup:
    """When each leg is driven and what moves."""
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


def reorder_tables(plan: Plan) -> tuple[Markup, Markup, Markup]:
    """What was changed, what that changed, and what other ways would have left."""
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
    changes = tag("ul", *(tag("li", change) for change in report.changes))
    return changes, table(("Quantity", "Before", "After"), rows), ways_table(plan)


def provenance_table(plan: Plan) -> Markup:
    """Files, checksums, planner and version."""
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
