"""report.html: a plan for people to look at, to question and to keep; the folder of a plan."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.package import counted
from ctrplan.certificate.certificate import FIGURES
from ctrplan.files.plan_inputs import INPUTS, SUFFIX, inputs_of, write_as_one
from ctrplan.files.trajectory_file import TrajectoryFormat, trajectory_formats, write_trajectory
from ctrplan.plans.plan import Plan, write_plan_json
from ctrplan.plans.planned_motion import leg_end_s, marked_trajectory, restarts
from ctrplan.reports.curves import (
    direction_panel,
    error_panel,
    margin_panels,
    position_panels,
    speed_panel,
    stacked_figure,
    timeline,
)
from ctrplan.reports.html_page import plot, rendered
from ctrplan.reports.plan_motion import WAY_NAMES, clearance_section, shown_motion
from ctrplan.reports.plan_scene import plan_scene
from ctrplan.reports.plan_words import (
    certificate_in_words,
    certificate_rows,
    standing,
    verdict,
    worst_arrival,
)
from ctrplan.reports.words import MEANING, VALUES, Markup, digits, millimetres, stated_in_words, term, uncertainty_rows
from ctrplan.storage.output_folder import output_folder, write_atomically, written_together

if TYPE_CHECKING:
    from ctrplan.plans.planned_motion import Leg, ReorderReport
    from ctrplan.reports.plan_scene import PlanScene


WORDS = (
    "worst-case friction error", "predicted friction error", "arrival", "restart", "tolerance",
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
    return rendered(
        "plan.html",
        title=f"{scenario.name} - ctrplan",
        plan=plan,
        scenario=scenario,
        robot=scenario.robot,
        certificate=plan.certificate,
        verdict=verdict(plan),
        standing=standing(plan),
        moving=shown_motion(scene),
        figures=[*_target_tiles(plan), *_figure_tiles(plan)],
        clearance=clearance_section(plan),
        certificate_words=certificate_in_words(plan),
        certificate_rows=certificate_rows(plan),
        uncertainty=uncertainty_section(plan),
        notes=tuple(dict.fromkeys((*plan.notes, *scenario.warnings))),
        margins=plot(margins_figure(plan), "margins"),
        joints=plot(joints_figure(plan), "joints"),
        ends_s=leg_end_s(plan),
        moves=partial(_moves, plan),
        leg_remarks=partial(_leg_remarks, plan),
        reordered=_reordered(plan.reorder),
        ways=sorted(plan.reorder.alternatives, key=lambda way: way.name != "as driven"),
        counted=counted,
        MEANING=MEANING,
        SHADES=SHADES,
        WAY_NAMES=WAY_NAMES,
        WORDS=WORDS,
    )


def uncertainty_section(plan: Plan) -> Markup:
    """Nothing where nothing is stated to be uncertain."""
    result = plan.uncertainty
    if result is None:
        return Markup()
    rows, stated = uncertainty_rows(plan), stated_in_words(result)
    return rendered("plan_uncertainty.html", uncertainty=result, rows=rows, stated=stated)


def _moves(plan: Plan, leg: Leg) -> Iterator[str]:
    for joint, a, b in zip(plan.scenario.robot.drive.joints, leg.start, leg.end, strict=True):
        if a != b:
            unit = "°" if joint.unit == "deg" else f" {joint.unit}"
            yield f"{joint.name}: {a / joint.si_per_unit:.2f}{unit} → {b / joint.si_per_unit:.2f}{unit}"


def _leg_remarks(plan: Plan, number: int) -> Iterator[str]:
    """Remarks on pairs, from 1, that forget their friction on a leg, and on runs that may begin there again."""
    arrival = plan.certificate.arrival
    if arrival is None:
        return
    for target, waypoint in enumerate(found := restarts(plan.certificate), start=1):
        if waypoint == number - 1:
            yield f"an interrupted run{f' to target {target}' if len(found) > 1 else ''} begins here again"
    for pair, erased in enumerate(arrival.erased, start=1):
        if erased.leg == number - 1:
            yield f"tubes {pair} and {pair + 1} forget the friction before"


def _reordered(report: ReorderReport) -> list[tuple[str, ...]]:
    """Quantities before and after."""
    figures: tuple[tuple[str, Callable[[float], str], float, float], ...] = (
        ("Cost of the path in the search", VALUES["mm"], report.cost_before_mm, report.cost_after_mm),
        (
            "Error summed over the path in the search",
            VALUES["mm"],
            report.error_integral_before_mm,
            report.error_integral_after_mm,
        ),
        ("Stops of the path in the search", str, report.stops_before, report.stops_after),
        *(
            (f"Of the cost, {name}", VALUES["mm"], before, report.terms_after_mm[name])
            for name, before in report.terms_before_mm.items()
        ),
    )
    return [(name, words(before), words(after)) for name, words, before, after in figures]


def margins_figure(plan: Plan) -> dict[str, Any]:
    """What the certificate found along the path, with what it requires as dashed lines."""
    return stacked_figure([error_panel(plan), direction_panel(plan), *margin_panels(plan)], timeline(plan))


def joints_figure(plan: Plan) -> dict[str, Any]:
    """Joint positions between their limits, and speeds as shares of theirs."""
    return stacked_figure([*position_panels(plan), speed_panel(plan)], timeline(plan))


def _target_tiles(plan: Plan) -> Iterator[tuple[str, str]]:
    """How far from its target the tip may end, beside what the scenario asks for."""
    if arrival := worst_arrival(plan):
        kind = "caution" if arrival.exceeds else "good"
        distance = Markup(f'<span class="{kind}">{millimetres(arrival.error_m)}</span>')
        meaning = f"from {arrival.target} at the farthest arrival; tolerance {millimetres(arrival.tolerance_m)}"
        yield distance, term("arrival", meaning)


def _figure_tiles(plan: Plan) -> Iterator[tuple[str, str]]:
    """Figures at the goal first, then those of the whole motion."""
    shown = [(name, figure) for name, figure in FIGURES.items() if figure.tile[1]]
    for name, figure in sorted(shown, key=lambda entry: entry[1].join != "last"):
        value = getattr(plan.certificate, name)
        if name == "min_clearance_m" and np.isinf(value):
            yield "free space", "no anatomy to stay clear of"
        else:
            yield VALUES[figure.unit](value), term(*figure.tile)
    stops = counted(plan.trajectory.stops, "stop")
    yield f"{digits(plan.trajectory.duration_s)} s", f"duration, {stops} on the way"


FORMATS = ("csv", "ros2")  # of the trajectory, where nothing else is asked for


PICTURES = ("report.html", "plan.png")


def plan_outputs(formats: Sequence[TrajectoryFormat], *, report: bool = True) -> list[str]:
    """The names of the files."""
    return ["plan.json", *(chosen.file_name for chosen in formats), *(PICTURES if report else ())]


def save_plan(
    plan: Plan, folder: str | os.PathLike[str], formats: Sequence[str] = FORMATS, *, report: bool = True
) -> Path:
    """Writes them as `ctrplan plan` does; returns the folder, which is made if need be. Raises CtrplanError.

    Scenario, robot and meshes are in inputs.zip, so that the folder opens from anywhere. A name that ends in .ctrplan
    is that of the folder as one file. Without its `report` a plan is for programs: no page, no picture, and no
    comparison with other ways to the goal, which the page shows. A page of an earlier plan is removed.
    """
    if os.fspath(folder).lower().endswith(SUFFIX):
        with tempfile.TemporaryDirectory() as within:
            write_as_one(save_plan(plan, within, formats, report=report), Path(folder))
        return Path(folder)
    chosen = trajectory_formats(formats)
    outputs = plan_outputs(chosen, report=report)
    place = output_folder(os.fspath(folder), outputs, PICTURES)
    scene, inputs = plan_scene(plan) if report else None, inputs_of(plan.scenario)  # writers solve nothing
    if scene is not None:
        from ctrplan.reports.plan_picture import write_plan_png  # matplotlib takes as long as a short search

        _ = plan.reorder.alternatives  # simulated now: plan.json has them, too
    names = [*outputs, *([] if inputs is None else [INPUTS])]
    earlier = [name for name in (*PICTURES, INPUTS) if name not in names]
    with written_together(place, names, earlier) as made:
        if inputs is not None:
            write_atomically(made / INPUTS, inputs)
        write_plan_json(made / "plan.json", plan)
        write_trajectory(made, marked_trajectory(plan), chosen)
        if scene is not None:
            write_plan_png(made / "plan.png", scene)
            write_plan_report(made / "report.html", scene)
    return place
