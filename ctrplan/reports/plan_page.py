"""report.html: a plan for people to look at, to question and to keep; the folder of a plan."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.package import __version__
from ctrplan.certificate.certificate import FIGURES
from ctrplan.files.trajectory_file import TrajectoryFormat, trajectory_formats, write_trajectory
from ctrplan.plans.plan import Plan, write_plan_json
from ctrplan.plans.planned_motion import leg_end_s
from ctrplan.reports.curves import (
    direction_panel,
    error_panel,
    margin_panels,
    position_panels,
    speed_panel,
    stacked_figure,
    timeline,
)
from ctrplan.reports.html_page import Markup, escaped, facts, lines, page, plot, section, table, tag
from ctrplan.reports.plan_motion import clearance_section, motion_section, ways_table
from ctrplan.reports.plan_picture import write_plan_png
from ctrplan.reports.plan_scene import plan_scene
from ctrplan.reports.plan_words import (
    MEANING,
    CertificateRow,
    certificate_in_words,
    certificate_rows,
    standing,
    verdict,
    worst_miss,
)
from ctrplan.reports.uncertainty_words import stated_in_words, uncertainty_rows
from ctrplan.reports.words import VALUES, degrees, digits, glossary, millimetres, term
from ctrplan.storage.output_folder import output_folder, write_atomically, written_together

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from ctrplan.base.arrays import Array
    from ctrplan.reports.plan_scene import PlanScene
    from ctrplan.uncertainty.result import GoalMiss, ParameterInterval
    from ctrplan.uncertainty.worst_case import Contributor, TurnContributor


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


BAR = 24  # blocks of the largest share


def uncertainty_section(plan: Plan) -> Markup:
    """Nothing where nothing is stated to be uncertain."""
    found = plan.uncertainty
    if found is None:
        return Markup()
    parts = [
        facts(list(uncertainty_rows(plan).items())),
        *(part for k, miss in enumerate(found.via, start=1) for part in _target(miss, _named(miss, k))),
        *_target(found.goal, "the goal"),
    ]
    if found.closest:
        parts += [tag("h3", "Causes where the robot comes nearest to the anatomy"), _causes(found.closest.contributors)]
    if found.parameters:
        parts += [tag("h3", "Intervals"), _intervals(found.parameters)]
    return section("What is uncertain", *parts, *(tag("p", text, kind="quiet") for text in stated_in_words(found)))


def _named(miss: GoalMiss, number: int) -> str:
    return f"target {number} ({miss.name})" if miss.name else f"target {number}"


def _target(miss: GoalMiss, name: str) -> list[Markup]:
    parts = [tag("h3", f"Causes at {name}"), _causes(miss.contributors)]
    if miss.turn:
        parts += [tag("h3", f"Causes of the turn at {name}"), _turns(miss.turn.contributors)]
    return parts


def _causes(contributors: Sequence[Contributor]) -> Markup:
    return _bars([(c.name, c.share_m, c.saved_m) for c in contributors], millimetres)


def _turns(contributors: Sequence[TurnContributor]) -> Markup:
    return _bars([(c.name, c.share_rad, c.saved_rad) for c in contributors], degrees)


def _bars(causes: Sequence[tuple[str, float, float]], said: Callable[[float], str]) -> Markup:
    largest = max((abs(share) for _, share, _ in causes), default=0.0) or 1.0
    rows = (
        (name, said(share), "█" * round(BAR * max(share, 0.0) / largest), said(saved)) for name, share, saved in causes
    )
    return table(("Cause", "Share of the worst case", "", "Measuring it would take off"), rows)


def _intervals(parameters: Sequence[ParameterInterval]) -> Markup:
    rows = (
        (p.name, p.title, f"{digits(p.value)} {p.unit}", f"{digits(p.low)} to {digits(p.high)} {p.unit}")
        for p in parameters
    )
    return table(("Parameter", "What it is", "Value", "95 % interval"), rows)


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


def _figure_tiles(plan: Plan) -> Iterator[tuple[str, str]]:
    """Figures at the goal first, then those of the whole motion."""
    shown = [(name, figure) for name, figure in FIGURES.items() if figure.tile[1]]
    for name, figure in sorted(shown, key=lambda entry: entry[1].join != "last"):
        value = getattr(plan.certificate, name)
        if name == "min_clearance_m" and np.isinf(value):
            yield "free space", "no anatomy to stay clear of"
        else:
            yield VALUES[figure.unit](value), term(*figure.tile)
    stops = _counted(plan.trajectory.stops, "stop")
    yield f"{digits(plan.trajectory.duration_s)} s", f"duration, {stops} on the way"


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


FORMATS = ("csv", "ros2")  # of the trajectory, where nothing else is asked for


def plan_outputs(formats: Sequence[TrajectoryFormat]) -> list[str]:
    """The names of the files."""
    return ["plan.json", *(chosen.file_name for chosen in formats), "report.html", "plan.png"]


def save_plan(plan: Plan, folder: str | os.PathLike[str], formats: Sequence[str] = FORMATS) -> Path:
    """Writes them as `ctrplan plan` does; returns the folder, which is made if need be. Raises CtrplanError."""
    chosen = trajectory_formats(formats)
    outputs = plan_outputs(chosen)
    place = output_folder(os.fspath(folder), outputs)
    scene = plan_scene(plan)  # writers solve nothing
    with written_together(place, outputs) as made:
        write_plan_json(made / "plan.json", plan)
        write_trajectory(made, plan.trajectory, chosen)
        write_plan_png(made / "plan.png", scene)
        write_plan_report(made / "report.html", scene)
    return place
