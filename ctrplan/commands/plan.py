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
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import SEARCH_TIME, SEED
from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.base.package import counted
from ctrplan.commands.options import (
    add_allow_outside_option,
    add_number,
    add_output_option,
    add_set_option,
)
from ctrplan.commands.terminal import ProgressBar, amber, tell_next, typed, warn
from ctrplan.errors import CtrplanError
from ctrplan.storage.output_folder import output_folder

if TYPE_CHECKING:
    from ctrplan.certificate.arrival import Arrival
    from ctrplan.certificate.certificate import Unit
    from ctrplan.plans.plan import Plan
    from ctrplan.reports.plan_words import TargetArrival

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
    parser.add_argument("--no-report", action="store_true", help="plan.json and the trajectory alone, sooner")
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
        from ctrplan.pipeline.chain import plan_range_notes
        from ctrplan.planning import plan
        from ctrplan.reports.plan_page import PICTURES, plan_outputs
        from ctrplan.reports.plan_words import standing

        scenario = load_scenario(arguments.scenario, arguments.overrides, allow_outside=arguments.allow_outside)
        formats = trajectory_formats(arguments.formats)
        is_file = str(arguments.output).lower().endswith(SUFFIX)
        outputs, report = plan_outputs(formats, report=not arguments.no_report), not arguments.no_report
        folder = Path(arguments.output) if is_file else output_folder(arguments.output, outputs, PICTURES)
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
        result.save(folder, arguments.formats, report=report)
        warn(plan_range_notes(scenario.robot, result.waypoints))
        print(_summary(folder, result, outputs))
        tell_next(
            f"ctrplan verify {typed(folder)}"
            + (f"; open {typed(folder / 'report.html')}" if report and not is_file else "")
        )
        warn(f"{folder / name} is of an earlier plan." for name in left_over(folder, formats))
        if interrupted.is_set():
            return INTERRUPTED
        if standing(result) == "good":
            return 0
        _print_levers(arguments, result, interrupted)
        return MAY_MISS


LEVERS_S = 10.0  # after which no lever is waited for, a budget
LEVER_SEARCH_S = 2.0  # of work counted in another search, a budget
POLL_S = 0.1  # between two looks at what is computed


@dataclass(frozen=True)
class Command:
    """What the command was given, or what is to be typed in its place."""

    scenario: str
    overrides: tuple[str, ...]
    seed: int
    is_compensated: bool
    allow_outside: bool

    def with_keys(self, *overrides: str) -> Command:
        """The command with keys of the scenario set anew."""
        keys = [text.split("=")[0].strip() for text in overrides]
        kept = [text for text in self.overrides if text.split("=")[0].strip() not in keys]
        return replace(self, overrides=(*kept, *overrides))

    def line(self, arguments: argparse.Namespace) -> str:
        """To be typed into a shell; output and time of the search as they were given, the latter unless it is a key."""
        words = ["ctrplan", "plan", self.scenario, "-o", str(arguments.output)]
        words += [word for text in self.overrides for word in ("--set", text)]
        words += ["--seed", str(self.seed)] if self.seed else []
        if arguments.time is not None and not any(text.startswith("planner.time_s") for text in self.overrides):
            words += ["--time", f"{arguments.time:g}"]
        words += [] if self.is_compensated else ["--no-compensation"]
        words += ["--no-report"] if arguments.no_report else []
        words += ["--allow-outside"] if self.allow_outside else []
        return shlex.join(words)


@dataclass(frozen=True)
class Lever:
    """Something that would bring the arrival nearer to its target: a plan, or an arrival, that was computed."""

    what: str
    off: float  # how far the worst target may be missed with it: m, or rad where only the direction is off
    command: Command | str  # to be typed; a string where it needs what only the user has


@dataclass
class Levers:
    """What was computed in time, and the names of what was not."""

    computed: list[Lever]
    missing: list[str]


def levers(
    plan: Plan, command: Command, until_s: float, interrupted: threading.Event, report: Callable[[], object]
) -> Levers:
    """What would help a plan that may miss its target, each computed, until a time of `time.monotonic`.

    What follows from the arrival's causes is known at once. Other plans are made in processes of their own, which are
    ended when the time is over or `interrupted` is set: planning cannot be told to end in the middle of a simulation.
    """
    from concurrent.futures import FIRST_COMPLETED, wait

    from ctrplan.reports.plan_words import worst_arrival
    from ctrplan.studies.child_process import ChildEnded, ChildExecutor

    worst = worst_arrival(plan)
    if worst is None or worst.arrival is None:
        return Levers([], [])
    is_turned = worst.error_m <= worst.tolerance_m
    computed = [] if is_turned else [*_known_better(plan, worst.arrival, command)]
    with ChildExecutor() as children:
        tries = {children.submit(function, *given): what for what, function, given in _tries(plan, worst, command)}
        pending = set(tries)
        while pending and time.monotonic() < until_s and not interrupted.is_set():
            done, pending = wait(pending, timeout=POLL_S, return_when=FIRST_COMPLETED)
            for future in done:
                with suppress(ChildEnded):
                    error_m, error_rad, improved = future.result()
                    computed.append(Lever(tries[future], error_rad if is_turned else error_m, improved))
            report()
        return Levers(computed, [what for future, what in tries.items() if future in pending])


def _print_levers(arguments: argparse.Namespace, plan: Plan, interrupted: threading.Event) -> None:
    """What would help, ranked, each with the line to type; the plan is written already."""
    from ctrplan.reports.plan_words import worst_arrival

    worst = worst_arrival(plan)
    if worst is None:
        return
    overrides, is_compensated = tuple(arguments.overrides), not arguments.no_compensation
    command = Command(arguments.scenario, overrides, arguments.seed, is_compensated, arguments.allow_outside)
    began = time.monotonic()
    with ProgressBar(quiet=arguments.quiet, patience_s=0.0) as bar:

        def report() -> None:
            bar.show("what would help", min(1.0, (time.monotonic() - began) / LEVERS_S))

        report()
        result = levers(plan, command, began + LEVERS_S, interrupted, report)
    is_turned = worst.error_m <= worst.tolerance_m
    off, most = (worst.error_rad, worst.direction_tolerance_rad) if is_turned else (worst.error_m, worst.tolerance_m)
    unit, scale = ("deg", math.degrees(1.0)) if is_turned else ("mm", 1e3)
    helpful = sorted((lever for lever in result.computed if lever.off < off), key=lambda lever: lever.off)
    print(
        f"  what would bring it below {off * scale:.2f} {unit}, computed:"
        if helpful
        else "  nothing computed brings it nearer"
    )
    for lever in helpful:
        enough = " (enough)" if most is not None and lever.off <= most else ""
        line = lever.command if isinstance(lever.command, str) else lever.command.line(arguments)
        print(f"    {lever.off * scale:8.2f} {unit}{enough}  {lever.what}: {line}")
    if math.isfinite(off):
        key = f"{worst_table(plan, worst)}.{'direction_tolerance_deg' if is_turned else 'tolerance_mm'}"
        allowed = command.with_keys(f"{key}={math.ceil(off * scale * 100) / 100:g}")
        print(f"    as it is, it keeps another tolerance: {allowed.line(arguments)}")
    if result.missing:
        why = "interrupted" if interrupted.is_set() else f"not within {LEVERS_S:g} s"
        print(f"    not computed ({why}): {', '.join(dict.fromkeys(result.missing))}")


def worst_table(plan: Plan, worst: TargetArrival) -> str:
    """The table of the scenario's file with the tolerances of a target."""
    names = {"the target": plan.scenario.goal.table}
    names |= {f"target {k}": goal.table for k, goal in enumerate(plan.scenario.via, start=1)}
    return names[worst.target.split(" (")[0]]


def _known_better(plan: Plan, arrival: Arrival, command: Command) -> Iterator[Lever]:
    """Uncertainties known to half, which the arrival's own shares tell."""
    cause, stated = arrival.by_cause, plan.scenario.registration
    if cause.registration_m > 0:
        position, rotation = stated.position_sigma_m * 1e3 / 2, math.degrees(stated.rotation_sigma_rad) / 2
        better = [f"base.position_sigma_mm={position:.3g}"] if position else []
        better += [f"base.rotation_sigma_deg={rotation:.3g}"] if rotation else []
        located = command.with_keys(*better)
        yield Lever("a registration twice as good", arrival.error_m - cause.registration_m / 2, located)
    if cause.parameters_m > 0:
        what, by_measuring = "parameters known to half their intervals", "ctrplan calibrate ROBOT MEASUREMENTS"
        yield Lever(what, arrival.error_m - cause.parameters_m / 2, by_measuring)


Answer = tuple[float, float, Command]  # [m] and [rad] that the worst target may be missed by, with a command


def _tries(
    plan: Plan, worst: TargetArrival, command: Command
) -> Iterator[tuple[str, Callable[..., Answer], tuple[Any, ...]]]:
    """What may help, the likeliest first: its name, a function that computes it, and its arguments."""
    scenario, arrival = plan.scenario, worst.arrival
    short = command
    if scenario.planner.time_s > LEVER_SEARCH_S:
        short = command.with_keys(f"planner.time_s={LEVER_SEARCH_S:g}")
    if not command.is_compensated:
        yield "compensation", _replanned, (replace(short, is_compensated=True),)
    friction = scenario.robot.friction.tolist()
    halves = {
        f"robot.contact.{k}.friction_coefficient=[{(3 * low + high) / 4:.4g}, {(low + 3 * high) / 4:.4g}]"
        for k, (low, high) in enumerate(friction, start=1)
        if low < high
    }
    if halves and arrival and arrival.by_cause.coefficients_m > 0:
        samples, certificate = plan.certificate.samples, plan.certificate
        motion = (samples.joints, samples.leg, certificate.goal_bound_m, certificate.goal_play_m)
        rest_m = arrival.error_m - arrival.by_cause.coefficients_m
        known = command.with_keys(*sorted(halves))
        yield "friction coefficients known to half their intervals", _better_known, (known, motion, rest_m)
    yield "another path and goal state", _replanned, (replace(short, seed=command.seed + 1),)
    past_m = arrival.by_cause.past_m if arrival else 0.0
    for kind, what in (("auto", "an ending by which every pair slips"), ("oscillate", "an oscillation at the end")):
        if past_m > 0.1 * scenario.goal.tolerance_m and scenario.planner.settle != kind:
            yield what, _replanned, (short.with_keys(f'planner.settle="{kind}"'),)
    yield "another path and goal state", _replanned, (replace(short, seed=command.seed + 2),)
    if scenario.goal.joints is None:
        yield "another base", _placed, (short,)


def _replanned(command: Command) -> Answer:
    """The plan of a command; inf where there is none."""
    from ctrplan.files.scenario_file import load_scenario
    from ctrplan.planning import plan
    from ctrplan.reports.plan_words import worst_arrival

    try:
        scenario = load_scenario(command.scenario, command.overrides, allow_outside=command.allow_outside)
        worst = worst_arrival(plan(scenario, seed=command.seed, compensated=command.is_compensated))
    except CtrplanError:
        return math.inf, math.inf, command
    return (worst.error_m, worst.error_rad, command) if worst else (math.inf, math.inf, command)


def _placed(command: Command) -> Answer:
    """The plan of a command with the base where `ctrplan place` would put it."""
    from ctrplan.files.file_content import base_key
    from ctrplan.files.scenario_file import load_scenario
    from ctrplan.planning.place import place

    scenario = load_scenario(command.scenario, command.overrides, allow_outside=command.allow_outside)
    try:
        pose = place(scenario, candidates=64, confirmed=2).poses[0]
    except CtrplanError:
        return math.inf, math.inf, command
    kept = tuple(text for text in command.overrides if not text.lstrip().startswith("base"))
    return _replanned(replace(command, overrides=(*kept, base_key(scenario, pose))))


def _better_known(command: Command, motion: tuple[Any, Any, float, float], rest_m: float) -> Answer:
    """The arrival of a motion, joints (K, m) on legs (K,), with other intervals of friction: that of the rest of causes
    and of these coefficients, simulated.
    """
    from ctrplan.certificate.arrival import arrival, simulated_rows
    from ctrplan.files.scenario_file import load_scenario
    from ctrplan.scenario.prediction import predict_end, start_states

    joints, leg, bound_m, play_m = motion
    scenario = load_scenario(command.scenario, command.overrides, allow_outside=command.allow_outside)
    scenario = replace(scenario, via=())
    rows, keep = simulated_rows(scenario, joints, leg)
    path, starts = (joints[rows], leg[rows]), start_states(scenario)
    prediction, _ = predict_end(scenario.robot, path[0], starts, keep=keep)
    known = arrival(scenario, *path, prediction, starts, goal_bound_m=bound_m, play_m=play_m)
    return rest_m + known.by_cause.coefficients_m, known.error_rad, command


def _summary(folder: Path, plan: Plan, outputs: Sequence[str]) -> str:
    name, duration_s, stops = plan.scenario.name, plan.trajectory.duration_s, plan.certificate.stops
    legs, halts = counted(len(plan.legs), "leg"), counted(stops, "stop")
    lines = [f"{name}: {legs}, {plan.style}, the motion takes {duration_s:.1f} s with {halts}"]
    if plan.style == "simultaneous":
        lines.append("  note: no path of rotations before translations was found in time; joints move simultaneously")
    lines += [f"  {label:27} {text}" for label, text in (_targets(plan) | _figures(plan)).items()]
    lines.append(f"  {'written to':27} {folder}/{', '.join(outputs)}")
    return "\n".join(lines)


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
    for name, cost_mm in reordered.terms_after_mm.items():
        lines["cost"] += f"; {name} {cost_mm:.1f} mm besides"
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
        causes = plan.certificate.arrival.by_cause.main
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
