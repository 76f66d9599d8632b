"""`ctrplan simulate`: what the robot does along a joint path or a measured log, as a table and a picture."""

from __future__ import annotations

import argparse
import math
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from ctrplan.base.arguments import MEMBERS, Number, in_plain_digits
from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.commands.options import add_igtl_option, add_number, add_output_option, add_set_option, refuse_alone
from ctrplan.commands.terminal import PATIENCE_S, ProgressBar, tell_next, typed, warn
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.storage.output_folder import output_folder, write_results

if TYPE_CHECKING:
    from ctrplan.mechanics.history import Start
    from ctrplan.robot.slow_states import SlowParameter
    from ctrplan.studies.follow import Following
    from ctrplan.studies.simulate import Simulation

FOLLOWED_OUTPUTS = ("followed.csv", "followed.png")


def run_simulate_measured(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError."""
    for option, value, default in (
        ("--start", arguments.start, "released"),
        ("--accuracy", arguments.accuracy, "search"),
    ):
        if value != default:
            raise InputError(
                "does not go with --measured, an observer starts from every state", key=option, value=value
            )
    with interrupt_event() as interrupted:
        from ctrplan.files.measurement_file import load_measurements
        from ctrplan.files.robot_file import load_robot
        from ctrplan.robot.slow_states import SlowOffset
        from ctrplan.studies.follow import follow

        robot = load_robot(arguments.robot, arguments.overrides)
        data = load_measurements(arguments.path, robot)
        folder = output_folder(arguments.output, FOLLOWED_OUTPUTS, inputs=[arguments.path, data.file])
        warn([*robot.warnings, *data.warnings])
        offset = SlowOffset((arguments.offset_mm or 0.0) * 1e-3, arguments.offset_steps or math.inf)
        with ProgressBar(patience_s=PATIENCE_S) as bar:
            result = follow(
                robot,
                data,
                offset=offset,
                slow=[_slow(text) for text in arguments.slow],
                **({} if arguments.histories is None else {"members": arguments.histories}),
                progress=lambda share: bar.show("following", share),
                interrupted=interrupted,
            )
        _write_followed(folder, result)
        print(_followed_summary(folder, result))
    return 0


def _slow(text: str) -> SlowParameter:
    """NAME=SIGMA."""
    from ctrplan.robot.slow_states import SlowParameter

    name, _, sigma = text.partition("=")
    value = in_plain_digits(sigma)
    if not name or value is None:
        raise InputError("must be NAME=SIGMA, as contact.1.friction_coefficient=0.1", key="--slow", value=text)
    return SlowParameter(name, value)


def _write_followed(folder: Path, result: Following) -> None:
    from ctrplan.reports.looks import png
    from ctrplan.reports.path_pictures import following_figure
    from ctrplan.studies.follow import followed_csv

    contents = followed_csv(result), png(following_figure(result))
    write_results(folder, dict(zip(FOLLOWED_OUTPUTS, contents, strict=True)))


def _followed_summary(folder: Path, result: Following) -> str:
    import numpy as np

    lines = [f"{result.robot.name}: {len(result.measured_m)} measured tips followed, off one step ahead:"]
    for label, error_m in (("with the observer", result.error_m), ("without", result.error_without_m)):
        error_mm = error_m[np.isfinite(error_m)] * 1e3
        if len(error_mm):
            rms, most = np.sqrt(np.mean(error_mm**2)), error_mm.max()
            lines.append(f"  {label:27} {rms:.3f} mm (rms), at most {most:.3f} mm")
    for name, values in result.parameters.items():
        lines.append(f"  {name:27} {values[-1, 0]:.4g} +- {1.96 * values[-1, 1]:.2g} in the end")
    inside = np.mean((result.low_m <= result.measured_m) & (result.measured_m <= result.high_m))
    lines.append(f"  {'within intervals of 95 %':27} {100 * inside:.0f} % of the measured coordinates")
    if len(out := result.data.rows[result.set_aside] + 1):
        rows = ", ".join(map(str, out[:5].tolist())) + (" ..." if len(out) > 5 else "")
        lines.append(f"  {'set aside':27} {len(out)}, farther off than noise and friction explain: row {rows}")
    lines.append(f"  {'written to':27} {folder}/{', '.join(FOLLOWED_OUTPUTS)}")
    return "\n".join(lines)


OUTPUTS = ("poses.csv", "simulate.png")


DESCRIPTION = (
    "Follow the friction of every contact along a joint path; write poses.csv (joints, tip, "
    "frictionless tip, deviation, bound, friction states, snaps) and simulate.png."
)
EXAMPLES = """PATH.csv has a header and a row per waypoint: theta_1_rad ... and l_1_m ..., base rotations and
translations of the tubes, outermost first; optionally sequence (runs that are approached afresh) and time_s. The
trajectory.csv of a plan is read as it is.

examples:
  ctrplan simulate scenarios/robots/three_tube.toml path.csv -o out
  ctrplan simulate scenarios/robots/three_tube.toml plan/trajectory.csv -o out
  ctrplan simulate scenarios/robots/three_tube.toml path.csv -o out --start oscillated
  ctrplan simulate scenarios/robots/three_tube.toml path.csv -o out --start +1,-1
  ctrplan simulate scenarios/robots/three_tube.toml path.csv -o out --igtl 18944
  ctrplan simulate robot.toml measurements.csv -o out --measured
  ctrplan simulate robot.toml measurements.csv -o out --measured --offset-mm 1 --offset-steps 50
  ctrplan simulate robot.toml measurements.csv -o out --measured --slow contact.1.friction_coefficient=0.1

With --measured the path is a log of measured tips (docs/measurements.md), and the robot is followed by them:
followed.csv and followed.png say how far off tips are that an observer expects one step ahead, and those of a
simulation without it.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("robot", metavar="ROBOT.toml")
    parser.add_argument("path", metavar="PATH.csv", help="or a mapping file (TOML): docs/measurements.md")
    add_output_option(parser)
    parser.add_argument(
        "--start",
        default="released",
        metavar="STATE",
        help="friction at the first waypoint: released, oscillated (a decreasing oscillation has let go of it), "
        "or a state in [-1, 1] per pair, as --start +1,-1 (default: %(default)s)",
    )
    parser.add_argument(
        "--accuracy", choices=["search", "certificate"], default="search", help="mesh (default: %(default)s)"
    )
    parser.add_argument(
        "--measured", action="store_true", help="PATH.csv holds measured tips: follow the robot by them, as an observer"
    )
    help_offset = "with --measured: what friction doesn't explain, as an offset of the tip (default: 0)"
    add_number(parser, "--offset-mm", Number(0, 100, "mm"), metavar="MM", help=help_offset)
    help_steps = "with --offset-mm: rows over which that offset changes (default: never)"
    add_number(parser, "--offset-steps", Number(1, 1e9), metavar="ROWS", help=help_steps)
    parser.add_argument(
        "--slow",
        action="append",
        default=[],
        metavar="NAME=SIGMA",
        help="with --measured: a number of the robot that is estimated besides, and how far its value may be off, SI",
    )
    help_members = "with --measured: friction states that are followed (default: 9)"
    add_number(parser, "--histories", MEMBERS, metavar="N", help=help_members)
    add_igtl_option(parser, "the simulated tip, row after row,")
    add_set_option(parser, "the robot's key")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError, also where no equilibrium is found to go on to."""
    if arguments.igtl is not None:
        from ctrplan.reports.openigtlink import pyigtl

        if arguments.measured:
            raise InputError("goes without --measured", key="--igtl", value=arguments.igtl)
        pyigtl()
    if arguments.offset_mm is None:
        refuse_alone({"--offset-steps": arguments.offset_steps}, "--offset-mm")
    if arguments.measured:
        return run_simulate_measured(arguments)
    options = {"--offset-mm": arguments.offset_mm, "--slow": arguments.slow, "--histories": arguments.histories}
    refuse_alone(options, "--measured")
    with interrupt_event() as interrupted:
        from ctrplan.files.measurement_file import load_joint_path
        from ctrplan.files.robot_file import load_robot
        from ctrplan.studies.simulate import simulate

        robot = load_robot(arguments.robot, arguments.overrides)
        start = start_state(arguments.start, robot.n - 1)
        path = load_joint_path(arguments.path, robot)
        folder = output_folder(arguments.output, OUTPUTS, inputs=[arguments.path, path.file])
        warn(robot.warnings)
        if interrupted.is_set():
            raise KeyboardInterrupt
        with ProgressBar(patience_s=PATIENCE_S) as bar:
            result = simulate(
                robot, path, start, accuracy=arguments.accuracy, progress=bar.show, interrupted=interrupted
            )
        warn(result.warnings)
        _write(folder, result)
        print(_summary(folder, result))
        tell_next(f"open {typed(folder)}; ctrplan bound, for what no history exceeds")
        if arguments.igtl is not None:
            _play(result, arguments.igtl, interrupted)
        if (row := result.failed_waypoint) is not None:
            rule = "no equilibrium was found on the way there; the files hold what lies before"
            raise NoAnswerError(f"{arguments.path}: row {row + 1}: {rule}.")
        return 0 if result.is_complete else INTERRUPTED


def start_state(text: str, pairs: int) -> Start:
    """The start state of --start: a word, or a friction state in [-1, 1] for each pair. Raises InputError."""
    if text in ("released", "oscillated"):
        return text  # type: ignore[return-value]
    example = ",".join(["+1"] * pairs)
    rule = f'must be "released", "oscillated" or {pairs} values in [-1, 1], one per pair, such as {example}'
    given = [in_plain_digits(part.strip()) for part in text.split(",")]
    phi = tuple(value for value in given if value is not None and abs(value) <= 1)
    if not len(phi) == len(given) == pairs:
        raise InputError(rule, key="--start", value=text)
    return phi


def _write(folder: Path, result: Simulation) -> None:
    from ctrplan.reports.looks import png
    from ctrplan.reports.path_pictures import simulation_figure
    from ctrplan.studies.simulate import poses_csv

    write_results(folder, dict(zip(OUTPUTS, (poses_csv(result), png(simulation_figure(result))), strict=True)))


def _play(result: Simulation, port: int, interrupted: threading.Event) -> None:
    """Sends the tips as fast as the path says, or ten a second; waits for a listener first."""
    from ctrplan.reports.openigtlink import play_tips

    play_tips(result, port, interrupted, lambda at: print(f"OpenIGTLink: waiting on 127.0.0.1:{at}", flush=True))


def _summary(folder: Path, result: Simulation) -> str:
    import numpy as np

    deviation_mm, bound_mm = result.deviation_m * 1e3, result.bounds.position_m * 1e3
    outcome = np.flatnonzero(np.isfinite(deviation_mm))
    count = int(np.isfinite(deviation_mm[result.waypoints]).sum())
    lines = [f"{result.robot.name}: {count} of {len(result.path.theta_commanded)} rows simulated"]
    if len(outcome):
        worst, last = outcome[np.argmax(deviation_mm[outcome])], outcome[-1]
        for label, k in (("largest friction error", worst), ("at the end", last)):
            where = f", at row {result.place[k] + 1:.4g}" if k == worst else ""
            worst_case = f"(worst case there {bound_mm[k]:.3f} mm)"
            lines.append(f"  {label:27} {deviation_mm[k]:.3f} mm {worst_case}{where}")
    snapped = np.flatnonzero(result.snaps)
    if len(snapped):
        rows = ", ".join(f"{result.place[k] + 1:.4g}" for k in snapped[:5].tolist())
        lines.append(f"  {'snaps':27} {int(result.snaps.sum())}, at row {rows}{' ...' if len(snapped) > 5 else ''}")
    lines.append(f"  {'written to':27} {folder}/poses.csv, simulate.png")
    return "\n".join(lines)
