"""`ctrplan plan`: plans a scenario, writes the results into a folder and summarises them."""

from __future__ import annotations

import argparse
import math
import shlex
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
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
from ctrplan.errors import CtrplanError
from ctrplan.storage.output_folder import output_folder

if TYPE_CHECKING:
    from ctrplan.certificate.arrival import Arrival
    from ctrplan.certificate.certificate import Unit
    from ctrplan.files.trajectory_file import TrajectoryFormat
    from ctrplan.plans.plan import Plan
    from ctrplan.reports.plan_words import TargetArrival
    from ctrplan.robot.robot import Robot

MAY_MISS = 3  # exit code: a safe plan was written, which may miss its target or is short of a requirement
FORMATS = ("csv", "ros2")  # of the trajectory, where --formats says nothing


DESCRIPTION = (
    "Plan a motion that keeps the worst-case friction error small; "
    "write plan.json, the trajectory (trajectory.csv and, for ROS 2, trajectory.yaml), report.html, plan.png."
)
EXAMPLES = """examples:
  ctrplan plan scenarios/vessel.toml -o out
  ctrplan plan scenarios/ribs.toml -o out --time 10 --seed 3
  ctrplan plan scenarios/ribs.toml -o out --set 'planner.settle="oscillate"'
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
        "--no-compensation",
        action="store_true",
        help="let the frictionless tip arrive, not the one that friction moves",
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
        from ctrplan.reports.plan_words import standing

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
                compensated=not arguments.no_compensation,
            )
        result.save(folder, arguments.formats)
        warn(plan_range_notes(scenario.robot, result.waypoints))
        print(_summary(folder, result, formats))
        tell_next(f"ctrplan verify {folder}" + ("" if is_file else f"; open {folder}/report.html"))
        warn(f"{folder / name} is of an earlier plan." for name in left_over(folder, formats))
        if interrupted.is_set():
            return INTERRUPTED
        if standing(result) == "good":
            return 0
        _print_levers(arguments, result, interrupted)
        return MAY_MISS


LEVERS_S = 10.0  # after which no other lever is looked for, a budget
LEVER_SEARCH_S = 2.0  # of another search, a budget
FINISH_S = 3.0  # that a plan takes after its search: later none is begun


@dataclass(frozen=True)
class Lever:
    """Something that would bring the arrival nearer to its target: a plan, or an arrival, that was computed."""

    what: str
    error_m: float  # of the worst target's arrival with it
    options: tuple[str, ...]  # to add to the command, or another command


def levers(plan: Plan, seed: int, until_s: float, interrupted: threading.Event) -> Iterator[Lever]:
    """What would help a plan that may miss its target, each computed, until a time of `time.monotonic`.

    First what follows from the arrival's causes, then other endings, other plans and other bases, as long as there is
    time. Setting `interrupted` ends a search.
    """
    from ctrplan.reports.plan_words import worst_arrival

    worst = worst_arrival(plan)
    if worst is None or worst.arrival is None:
        return
    yield from _known_better(plan, worst.arrival)
    timer = threading.Timer(max(until_s - time.monotonic() - FINISH_S, 0.1), interrupted.set)
    timer.daemon = True
    timer.start()
    try:
        for what, options, made in _replanned(plan, seed, interrupted):
            if time.monotonic() > until_s - FINISH_S or interrupted.is_set():
                return
            with suppress(CtrplanError, KeyboardInterrupt):
                other = worst_arrival(made())
                if other is not None:
                    yield Lever(what, other.error_m, options)
    finally:
        timer.cancel()


def _print_levers(arguments: argparse.Namespace, plan: Plan, interrupted: threading.Event) -> None:
    """What would help, ranked, each with the line to type; the plan is written already."""
    from ctrplan.reports.plan_words import worst_arrival

    worst, results = worst_arrival(plan), list[Lever]()
    if worst is None:
        return
    began = time.monotonic()
    with ProgressBar(quiet=arguments.quiet, patience_s=0.0) as bar:
        bar.show("what would help", 0.0)
        for lever in levers(plan, arguments.seed, began + LEVERS_S, interrupted):
            results.append(lever)
            bar.show("what would help", min(1.0, (time.monotonic() - began) / LEVERS_S))
    was_cut = interrupted.is_set() and time.monotonic() - began < LEVERS_S - FINISH_S
    given = ["ctrplan", "plan", arguments.scenario, "-o", arguments.output]
    given += [word for override in arguments.overrides for word in ("--set", override)]
    helpful = sorted((lever for lever in results if lever.error_m < worst.error_m), key=lambda lever: lever.error_m)
    table = worst_table(plan, worst)
    enough_mm = math.ceil(worst.error_m * 1e5) / 100 if math.isfinite(worst.error_m) else math.inf
    tolerance = [Lever("another tolerance", worst.error_m, _set([f"{table}={enough_mm:g}"]))]
    print(f"  what would bring it below {worst.error_m * 1e3:.2f} mm, computed:")
    for lever in (*helpful, *(tolerance if math.isfinite(worst.error_m) else ())):
        is_command = lever.options[0].startswith("ctrplan ")
        line = f"{lever.options[0]} ..." if is_command else shlex.join([*given, *lever.options])
        print(f"    {lever.error_m * 1e3:8.2f} mm  {lever.what}: {line}")
    if was_cut:
        print("    interrupted: other levers were not computed")


def worst_table(plan: Plan, worst: TargetArrival) -> str:
    """The key of the scenario's file with the tolerance of a target."""
    names = {"the target": plan.scenario.goal.table}
    names |= {f"target {k}": goal.table for k, goal in enumerate(plan.scenario.via, start=1)}
    return f"{names[worst.target.split(' (')[0]]}.tolerance_mm"


def _known_better(plan: Plan, arrival: Arrival) -> Iterator[Lever]:
    """Uncertainties known to half, which the arrival's own shares tell; contacts' friction is simulated again."""
    scenario, cause = plan.scenario, arrival.by_cause
    stated = scenario.registration
    if cause.registration_m > 0:
        position, rotation = stated.position_sigma_m * 1e3 / 2, math.degrees(stated.rotation_sigma_rad) / 2
        better = [f"base.position_sigma_mm={position:.3g}"] if position else []
        better += [f"base.rotation_sigma_deg={rotation:.3g}"] if rotation else []
        yield Lever("a registration twice as good", arrival.error_m - cause.registration_m / 2, _set(better))
    halved = {
        k: (float(3 * low + high) / 4, float(low + 3 * high) / 4)
        for k, (low, high) in enumerate(scenario.robot.friction.tolist())
        if low < high
    }
    if halved and cause.coefficients_m > 0:
        known = list(scenario.robot.contacts)
        for k, interval in halved.items():
            known[k] = replace(known[k], friction_coefficient=interval)
        left_m = _arrival_of(plan, replace(scenario.robot, contacts=tuple(known))).by_cause.coefficients_m
        error_m = arrival.error_m - (cause.coefficients_m - left_m)
        intervals = [f"robot.contact.{k + 1}.friction_coefficient=[{a:.4g}, {b:.4g}]" for k, (a, b) in halved.items()]
        yield Lever("friction coefficients known to half their intervals", error_m, _set(intervals))
    if cause.parameters_m > 0:
        what = "parameters calibrated to half their intervals"
        yield Lever(what, arrival.error_m - cause.parameters_m / 2, ("ctrplan calibrate",))


def _set(keys: Sequence[str]) -> tuple[str, ...]:
    """Options that set keys."""
    return tuple(word for key in keys for word in ("--set", key))


def _arrival_of(plan: Plan, robot: Robot) -> Arrival:
    """The arrival of the plan's motion at its goal with another robot."""
    from ctrplan.certificate.arrival import arrival, simulated_rows
    from ctrplan.scenario.prediction import predict_end, start_states

    samples, scenario = plan.certificate.samples, replace(plan.scenario, robot=robot, via=())
    rows, keep = simulated_rows(scenario, samples.joints, samples.leg)
    path, starts = (samples.joints[rows], samples.leg[rows]), start_states(scenario)
    prediction, _ = predict_end(robot, path[0], starts, keep=keep)
    bound_m, play_m = plan.certificate.goal_bound_m, plan.certificate.goal_play_m
    return arrival(scenario, *path, prediction, starts, goal_bound_m=bound_m, play_m=play_m)


def _replanned(
    plan: Plan, seed: int, interrupted: threading.Event
) -> Iterator[tuple[str, tuple[str, ...], Callable[[], Plan]]]:
    """Other plans that may arrive better, the likeliest first: what is changed, options, and how to make it."""
    from msgspec.structs import replace as with_settings

    from ctrplan.planning.place import place
    from ctrplan.planning.planner import plan as planned

    scenario, arrival = plan.scenario, plan.certificate.arrival
    make = partial(planned, time_s=LEVER_SEARCH_S, interrupted=interrupted)
    past_m = arrival.by_cause.past_m if arrival else 0.0
    for kind, what in (("auto", "an ending by which every pair slips"), ("oscillate", "an oscillation at the end")):
        if past_m > 0.1 * scenario.goal.tolerance_m and scenario.planner.settle != kind:
            other = replace(scenario, planner=with_settings(scenario.planner, settle=kind))
            yield what, _set([f'planner.settle="{kind}"']), partial(make, other, seed=seed)
    for number in (seed + 1, seed + 2):
        yield "another path and goal state", ("--seed", str(number)), partial(make, scenario, seed=number)
    if scenario.goal.joints is None:

        def moved() -> Plan:
            pose = place(scenario, candidates=64, confirmed=2, interrupted=interrupted).poses[0]
            return make(pose.scenario, seed=seed)

        yield "another base", ("ctrplan place",), moved


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

    certificate, reordered, lines = plan.certificate, plan.reorder, _arrivals(plan)
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


def _arrivals(plan: Plan) -> dict[str, str]:
    """How near each target the motion brings the tip, amber on a terminal where that is beyond the tolerance."""
    from ctrplan.reports.plan_words import restart_words, target_arrivals

    texts = {}
    for arrival in target_arrivals(plan):
        label = "arrival" if arrival.target == "the target" else f"at {arrival.target.split(' (')[0]}"
        before_m = arrival.corrected_from_m
        corrected = f" ({before_m * 1e3:.2f} mm before the end was corrected)" if before_m is not None else ""
        texts[label] = (amber if arrival.exceeds else str)(arrival.sentence + corrected)
    if plan.certificate.arrival:
        causes = plan.certificate.arrival.by_cause.told
        texts["arrival error by cause"] = ", ".join(f"{share * 1e3:.3f} mm {words}" for words, share in causes)
        texts["interrupted"] = f"begin again {restart_words(plan)}"
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
    if compensation and compensation.note:
        lines["not compensated"] = compensation.note
    return lines
