"""`ctrplan plan`: plans a scenario, writes the results into a folder and summarises them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ctrplan.base.arguments import SEARCH_TIME, SEED
from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.commands.options import (
    add_allow_outside_option,
    add_number,
    add_output_option,
    add_set_option,
)
from ctrplan.commands.terminal import ProgressBar, amber, tell_next, warn
from ctrplan.storage.output_folder import output_folder

if TYPE_CHECKING:
    from ctrplan.certificate.certificate import Unit
    from ctrplan.files.trajectory_file import TrajectoryFormat
    from ctrplan.plans.plan import Plan

FORMATS = ("csv", "ros2")  # of the trajectory, where --formats says nothing


DESCRIPTION = (
    "Plan a motion that keeps the worst-case friction error small; "
    "write plan.json, the trajectory (trajectory.csv and, for ROS 2, trajectory.yaml), report.html, plan.png."
)
EXAMPLES = """examples:
  ctrplan plan scenarios/vessel.toml -o out
  ctrplan plan scenarios/ribs.toml -o out --time 10 --seed 3
  ctrplan plan scenarios/ribs.toml -o out --compensate --set 'planner.settle="oscillate"'
  ctrplan plan scenarios/ribs.toml -o out --set cost.error_goal=0 --set robot.contact.1.friction_coefficient=0.3
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("scenario", metavar="SCENARIO.toml")
    add_output_option(parser)
    add_number(parser, "--seed", SEED, default=0, help="seed of the search (default: %(default)s)")
    add_number(
        parser,
        "--time",
        SEARCH_TIME,
        metavar="S",
        help="seconds of search by the clock (default: work that takes about the scenario's planner.time_s)",
    )
    parser.add_argument(
        "--compensate",
        action="store_true",
        help="command joints so that the tip predicted with friction arrives, not the frictionless one",
    )
    parser.add_argument(
        "--formats",
        nargs="*",
        default=list(FORMATS),
        metavar="FORMAT",
        help=f"formats of the trajectory (default: {' '.join(FORMATS)})",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.add_argument("--no-field", action="store_true", help=argparse.SUPPRESS)  # has no meaning since 0.2
    add_allow_outside_option(parser)
    add_set_option(parser, "the scenario's key, or the robot's after robot.", "robot.tube.2.poisson_ratio=0.28")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError when there is no plan to write."""
    with interrupt_event() as interrupted:
        from ctrplan.files.plan_inputs import SUFFIX
        from ctrplan.files.scenario_file import load_scenario
        from ctrplan.files.trajectory_file import left_over, trajectory_formats
        from ctrplan.pipeline.installed import plan_range_notes
        from ctrplan.planning import plan
        from ctrplan.reports.plan_page import plan_outputs

        scenario = load_scenario(arguments.scenario, arguments.overrides, allow_outside=arguments.allow_outside)
        formats = trajectory_formats(arguments.formats)
        is_file = str(arguments.output).lower().endswith(SUFFIX)
        folder = Path(arguments.output) if is_file else output_folder(arguments.output, plan_outputs(formats))
        warn(scenario.warnings)
        if interrupted.is_set():
            raise KeyboardInterrupt
        with ProgressBar(quiet=arguments.quiet) as bar:
            result = plan(
                scenario,
                seed=arguments.seed,
                time_s=arguments.time,
                progress=bar.update,
                interrupted=interrupted,
                compensated=arguments.compensate,
            )
        result.save(folder, arguments.formats)
        warn(plan_range_notes(scenario.robot, result.waypoints))
        print(_summary(folder, result, formats))
        tell_next(f"ctrplan verify {folder}" + ("" if is_file else f"; open {folder}/report.html"))
        warn(f"{folder / name} is of an earlier plan." for name in left_over(folder, formats))
        return INTERRUPTED if interrupted.is_set() else 0


def _summary(folder: Path, plan: Plan, formats: Sequence[TrajectoryFormat]) -> str:
    from ctrplan.reports.plan_page import plan_outputs

    name, duration_s, stops = plan.scenario.name, plan.trajectory.duration_s, plan.certificate.stops
    legs, halts = _counted(len(plan.legs), "leg"), _counted(stops, "stop")
    lines = [f"{name}: {legs}, {plan.style}, the motion takes {duration_s:.1f} s with {halts}"]
    if plan.style == "simultaneous":
        lines.append("  note: no path of rotations before translations was found in time; joints move simultaneously")
    lines += [f"  {label:27} {text}" for label, text in (_targets(plan) | _figures(plan)).items()]
    lines.append(f"  {'written to':27} {folder}/{', '.join(plan_outputs(formats))}")
    return "\n".join(lines)


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def _targets(plan: Plan) -> dict[str, str]:
    """A line for each of several targets."""
    if not plan.scenario.via:
        return {}
    texts = {}
    for number, target in enumerate(plan.certificate.targets, start=1):
        label = f"target {number}{f', {target.name}' if target.name else ''}"
        texts[label] = (
            f"{target.tip_error_m * 1e3:.2f} mm off without friction, {target.bound_m * 1e3:.2f} mm with it at worst"
        )
        if target.line_error_m is not None:
            texts[label] += f", {target.line_error_m * 1e3:.2f} mm off the line"
    return texts


VALUES: dict[Unit, Callable[[float], str]] = {
    "m": lambda value: f"{value * 1e3:.2f} mm",
    "rad": lambda value: f"{math.degrees(value):.2f} deg",
    "mm": lambda value: f"{value:.1f} mm",
    "share": lambda value: f"{100 * value:.2f} %",
    "number": lambda value: f"{value:.2f}",
    "count": str,
}


def _figures(plan: Plan) -> dict[str, str]:
    """The table of figures in lines, with what is said of targets, extras, uncertainty and clearances between them."""
    from ctrplan.certificate.certificate import FIGURES
    from ctrplan.reports.words import uncertainty_rows

    certificate, reordered, lines = plan.certificate, plan.reorder, _misses(plan)
    for name, figure in FIGURES.items():
        (label, around), value = figure.line, getattr(certificate, name)
        if name == "min_clearance_m":
            lines |= _extras(plan) | uncertainty_rows(plan) | _clearances(plan)
        elif label:
            before = f"{lines[label]}, " if label in lines else ""
            lines[label] = before + around.format(VALUES[figure.unit](value))
    before, after = (f"{cost_mm:.1f}" for cost_mm in (reordered.cost_before_mm, reordered.cost_after_mm))
    lines["cost"] += f"; reordering took {before} to {after} mm" if before != after else ""
    count, spacing = len(certificate.samples.leg), VALUES["m"](certificate.spacing_m)
    return lines | {"certified on": f"{count} samples, no point moves more than {spacing} between two"}


def _clearances(plan: Plan) -> dict[str, str]:
    """Without friction, in its worst state, and as certified; what is assumed of friction at the start."""
    from ctrplan.reports.plan_words import LABELS, START_FRICTION, clearance_rows

    rows = {LABELS[row.kind]: row.sentence for row in clearance_rows(plan)}
    start = START_FRICTION[plan.certificate.start_friction]
    return {**(rows or {"clearance": "free space"}), "friction before the start": start}


def _misses(plan: Plan) -> dict[str, str]:
    """Each target's distance at worst beside its tolerance, amber on a terminal where it is beyond."""
    from ctrplan.reports.plan_words import worst_misses

    texts = {}
    for miss in worst_misses(plan):
        text = miss.sentence.removeprefix("at worst the tip ends ")
        label = "tip at worst" if miss.target == "the target" else f"at worst at {miss.target.split(' (')[0]}"
        texts[label] = amber(text) if miss.exceeds else text
    return texts


def _extras(plan: Plan) -> dict[str, str]:
    """Lines about what was asked for beyond the path."""
    from ctrplan.plans.planned_motion import settling_duration_s

    lines, settling, compensation = dict[str, str](), plan.certificate.settling, plan.compensation
    if plan.certificate.worst_play_m:
        play_mm, way_mm = plan.certificate.goal_play_m * 1e3, plan.certificate.worst_play_m * 1e3
        lines["play of the drive"] = f"{play_mm:.2f} mm at the goal, {way_mm:.2f} mm on the way"
    if settling:
        before_mm, after_mm = settling.goal_predicted_before_m * 1e3, settling.goal_predicted_after_m * 1e3
        turn = f"{math.degrees(settling.amplitude_rad):.0f} deg in {settling_duration_s(plan):.0f} s"
        lines["settling oscillation"] = f"{turn}, predicted error {before_mm:.2f} to {after_mm:.2f} mm"
    if compensation:
        without_mm, with_mm = compensation.error_without_m * 1e3, compensation.error_with_m * 1e3
        lines["predicted tip to target"] = f"{with_mm:.2f} mm, {without_mm:.2f} mm without compensation"
    return lines
