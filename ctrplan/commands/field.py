"""`ctrplan field`: tabulates a robot's bound, once, so that plans with it are found sooner."""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING, Any

from ctrplan.commands.options import add_set_option
from ctrplan.commands.terminal import ProgressBar
from ctrplan.storage.output_folder import output_folder, write_results

if TYPE_CHECKING:
    from ctrplan.motion.bound_table import BoundTable

OUTPUTS = ("report.html",)


def add_parser(commands: Any) -> None:
    """Adds the command to the command line."""
    parser = commands.add_parser(
        "field",
        help="tabulate a robot's friction bound, so that plans are found sooner",
        description="Solve the bound on a grid over the joints that matter, once per robot; it is kept in the cache "
        "($CTRPLAN_CACHE_DIR or ~/.cache/ctrplan) and used by every `ctrplan plan` with the same robot.",
        epilog="examples:\n  ctrplan field scenarios/robots/three_tube.toml\n"
        "  ctrplan field scenarios/robots/three_tube.toml -o out\n",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("robot", metavar="ROBOT.toml")
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for {OUTPUTS[0]}, about the table")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    add_set_option(parser, "the robot's key")
    parser.set_defaults(run=run_field)


def run_field(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError."""
    from ctrplan.files.robot_file import load_robot
    from ctrplan.motion.bound_table import choose_axes, tabulated_bounds

    robot = load_robot(arguments.robot, arguments.overrides)
    folder = output_folder(arguments.output, OUTPUTS) if arguments.output is not None else None
    points = 1
    for axis in choose_axes(robot):
        points *= axis.count
    began = time.monotonic()
    terminal = sys.stderr is not None and sys.stderr.isatty()
    with ProgressBar(quiet=arguments.quiet or not terminal) as bar:
        field = tabulated_bounds(robot, progress=lambda share: bar.show("bound field", share), keep=True)
    assert field is not None
    print(f"{robot.name}: bound field of {points:,} configurations, {time.monotonic() - began:.1f} s")
    _print_errors(field)
    if folder is not None:
        from ctrplan.reports.bound_table_page import bound_table_report_html

        write_results(folder, {OUTPUTS[0]: bound_table_report_html(field)})
        print(f"  {'written to':27} {folder / OUTPUTS[0]}")
    return 0


def _print_errors(field: BoundTable) -> None:
    error = field.error
    if error.answers_nothing:
        print("  It has an answer for none of the configurations tried, all by unstable ones: plans do without it.")
        return
    print(f"  {'added to looked-up bounds':27} {error.margin_m * 1e3:.2f} mm, enough for 99 % of configurations")
    print(f"  {'largest error found':27} {error.largest_m * 1e3:.2f} mm; certificates use the model itself")
    print(f"  {'without an answer':27} {100 * error.uncovered:.1f} % of configurations, next to unstable ones")
    print(f"  {'bounds in it, median':27} {field.median_m * 1e3:.2f} mm")
    if error.margin_m > field.median_m:
        print("  What is added exceeds half of the bounds in it: looked-up ones say little of a configuration.")
    print("  Each plan measures on motions of its own scenario whether it helps, says so, and else leaves it alone.")
