"""report.html: a plan for people to look at, to question and to keep."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.reports.glossary import glossary, term
from ctrplan.reports.html_page import Markup, escaped, page, plot, section, tag
from ctrplan.reports.plan_curves import (
    direction_panel,
    error_panel,
    margin_panels,
    position_panels,
    speed_panel,
    timeline,
)
from ctrplan.reports.plan_page.motion import motion_section
from ctrplan.reports.plan_page.narrowest import clearance_section
from ctrplan.reports.plan_page.panels import stacked_figure
from ctrplan.reports.plan_page.tables import (
    certificate_table,
    leg_table,
    provenance_table,
    reorder_tables,
    target_section,
)
from ctrplan.reports.plan_page.uncertainty import uncertainty_section
from ctrplan.reports.plan_words.meaning import MEANING
from ctrplan.reports.plan_words.numbers import digits, millimetres
from ctrplan.reports.plan_words.verdict import standing, verdict
from ctrplan.reports.plan_words.verdict_words import certificate_in_words
from ctrplan.reports.plan_words.worst_miss import worst_miss
from ctrplan.storage.atomic_write import write_atomically

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from ctrplan.planning.plan import Plan
    from ctrplan.reports.plan_scene import PlanScene

WORDS = (
    "worst-case friction error", "predicted friction error", "worst case at the target", "tolerance",
    "envelope of friction", "corner shapes", "friction state", "clearance", "clearance without friction",
    "clearance in the worst friction state", "certified clearance", "stability", "strain", "play", "Coulomb friction",
)  # fmt: skip
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
        tag("p", verdict(plan), kind=f"verdict {standing(plan)}"),
        _remarks("What is wrong", plan.certificate.problems),
        motion_section(scene),
        _tiles(plan),
        clearance_section(plan),
        section("Certificate", *(tag("p", text) for text in certificate_in_words(plan)), certificate_table(plan)),
        uncertainty_section(plan),
        target_section(plan),
        _remarks("Remarks", tuple(dict.fromkeys((*plan.notes, *scenario.warnings)))),
        _errors_and_margins(plan),
        _joints(plan),
        section("Legs", leg_table(plan)),
        section("What reordering changed", *reorder_tables(plan)),
        section("What the error bound means", *(tag("p", text) for text in MEANING)),
        section("Words", glossary(*WORDS)),
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
    shown = [*_target_tiles(plan), *_figure_tiles(plan)]
    return tag(
        "div", *(tag("div", tag("b", value), tag("span", name), kind="tile") for value, name in shown), kind="tiles"
    )


def _target_tiles(plan: Plan) -> Iterator[tuple[str, str]]:
    """How far from its target the tip may end, beside what the scenario asks for."""
    if miss := worst_miss(plan):
        total = tag("span", millimetres(miss.total_m), kind="caution" if miss.exceeds else "good")
        asked = f"from {miss.target} at worst; tolerance {millimetres(miss.tolerance_m)}"
        yield total, term("worst case at the target", asked)


def _figure_tiles(plan: Plan) -> list[tuple[str, str]]:
    certificate = plan.certificate
    clearance = (
        millimetres(certificate.min_clearance_m),
        term("certified clearance", "certified clearance beyond the margins"),
    )
    if np.isinf(certificate.min_clearance_m):
        clearance = ("free space", escaped("no anatomy to stay clear of"))
    return [
        (
            millimetres(certificate.goal_bound_m),
            term("worst-case friction error", "worst-case friction error at the goal"),
        ),
        (
            millimetres(certificate.goal_predicted_m),
            term("predicted friction error", "predicted friction error at the goal"),
        ),
        (
            millimetres(certificate.worst_bound_m),
            term("worst-case friction error", "worst case at most along the path"),
        ),
        clearance,
        (digits(certificate.min_stability), term("stability", "smallest stability")),
        (f"{digits(plan.trajectory.duration_s)} s", f"duration, {_counted(plan.trajectory.stops, 'stop')} on the way"),
    ]


def _errors_and_margins(plan: Plan) -> Markup:
    count = len(plan.certificate.samples.joints)
    hint = f"{_counted(count, 'place')} of the path, each solved with the full model. {SHADES}"
    return section(
        "Errors and margins along the path",
        tag("p", hint, kind="quiet"),
        plot(margins_figure(plan), "margins", kind="plot twin"),
    )


def _joints(plan: Plan) -> Markup:
    return section("Joints", tag("p", SHADES, kind="quiet"), plot(joints_figure(plan), "joints", kind="plot twin"))


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"
