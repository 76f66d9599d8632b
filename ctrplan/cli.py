"""The command line: what `ctrplan --help` lists. Every failure is one sentence on stderr and an exit code."""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from typing import Any

import ctrplan
from ctrplan.commands.bound import run_bound
from ctrplan.commands.ik import run_ik
from ctrplan.commands.output_folder import DEFAULT as OUTPUT
from ctrplan.commands.plan import INTERRUPTED, run_plan
from ctrplan.commands.view import run_view
from ctrplan.errors import CtrplanError

PLAN_EXAMPLES = """examples:
  ctrplan plan scenarios/vessel.toml -o out
  ctrplan plan scenarios/ribs.toml -o out --time 10 --seed 3
  ctrplan plan scenarios/ribs.toml -o out --set cost.error_goal=0 --set robot.contact.1.friction_coefficient=0.3
"""
BOUND_EXAMPLES = """examples:
  ctrplan bound scenarios/robots/three_tube.toml --theta-deg 0 90 180 --l-mm 0 -17 -62.8
  ctrplan bound scenarios/robots/table_1_pair.toml --theta-deg 0 180 --l-mm 0 -17 \
--set contact.1.friction_coefficient=0.4
  ctrplan bound scenarios/robots/three_tube.toml --theta-deg 0 90 0 --l-mm 0 -17 -62.8 --sweep theta_3=0:360:121 -o out
  ctrplan bound scenarios/robots/table_1_pair.toml --theta-deg 0 180 --l-mm 0 -17 -o out \
--sweep contact.1.clearance_mm=0.05:3:30 --sweep contact.1.friction_coefficient=0:0.5:26
"""
IK_EXAMPLES = """examples:
  ctrplan ik scenarios/robots/three_tube.toml --tip-mm 34 -47 200
  ctrplan ik scenarios/vessel.toml --tip-mm 51 2 168 --direction 1 0 0.4 --direction-tolerance-deg 20 --json
"""
VIEW_EXAMPLES = """examples:
  ctrplan view scenarios/robots/three_tube.toml
  ctrplan view scenarios/airway.toml --no-browser --port 8080
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns its exit code: 0 done, 1 no answer, 2 malformed input, 130 interrupted."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a name the terminal can't show must not end the program
    parsed = _parser().parse_args(arguments)
    try:
        code = int(parsed.run(parsed))
        sys.stdout.flush()
        return code
    except CtrplanError as error:
        print(f"ctrplan: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("ctrplan: interrupted before there was a result.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output went away
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:  # of standard output; files have sentences of their own
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"ctrplan: could not print the result: {error.strerror or error}.", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="ctrplan", description=(ctrplan.__doc__ or "").splitlines()[0])
    parser.add_argument("--version", action="version", version=f"ctrplan {ctrplan.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_plan(commands)
    _add_bound(commands)
    _add_ik(commands)
    _add_view(commands)
    return parser


def _add_plan(commands: Any) -> None:
    parser = commands.add_parser(
        "plan",
        help="plan a certified motion and write a trajectory for the drive",
        description="Plan a motion that keeps the worst-case friction error small; "
        "write plan.json, trajectory.csv, trajectory.yaml (ROS 2), report.html, plan.png.",
        epilog=PLAN_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scenario", metavar="SCENARIO.toml")
    parser.add_argument(
        "-o", "--output", metavar="DIR", default=OUTPUT, help="folder for the results (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default: %(default)s)")
    parser.add_argument(
        "--time", type=float, metavar="S", help="seconds of search (default: the scenario's planner.time_s)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    _add_set(parser, "the scenario's key, or the robot's after robot.")
    parser.set_defaults(run=run_plan)


def _add_bound(commands: Any) -> None:
    parser = commands.add_parser(
        "bound",
        help="bound the friction error at one configuration, or over a sweep",
        description="Largest tip deviation that friction can cause at one configuration, "
        "over all directions of approach; with --sweep, sweep.csv and sweep.png over one or two axes.",
        epilog=BOUND_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("robot", metavar="ROBOT.toml")
    for option, metavar, what in (
        ("--theta-deg", "DEG", "base rotations, outermost tube first"),
        ("--l-mm", "MM", "base translations, outermost tube first, <= 0"),
    ):
        parser.add_argument(option, type=float, nargs="+", required=True, metavar=metavar, help=what)
    parser.add_argument(
        "--sweep",
        action="append",
        default=[],
        metavar="KEY=FROM:TO:COUNT",
        help="axis of a sweep, at most two: theta_I (deg) or l_I (mm) of tube I, or a key as in --set",
    )
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for a sweep's files (default: {OUTPUT})")
    parser.add_argument(
        "--accuracy", choices=["search", "certificate"], help="mesh (default: certificate; search with --sweep)"
    )
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    _add_set(parser, "the robot's key")
    parser.set_defaults(run=run_bound)


def _add_ik(commands: Any) -> None:
    parser = commands.add_parser(
        "ik",
        help="every way to bring the tip to a point, with the friction bound of each",
        description="Inverse kinematics: distinct configurations whose frictionless tip reaches a point, sorted by the "
        "worst-case friction error; with a scenario, also their clearance to its anatomy.",
        epilog=IK_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", metavar="ROBOT.toml|SCENARIO.toml")
    xyz = {"type": float, "nargs": 3, "metavar": ("X", "Y", "Z")}
    parser.add_argument("--tip-mm", required=True, help="the point; a scenario's is in the anatomy's frame", **xyz)
    parser.add_argument("--direction", help="of the tip, any length", **xyz)
    for option, default, what in (
        ("--tolerance-mm", 0.1, "distance from the point that counts as there (default: %(default)s)"),
        ("--direction-tolerance-deg", 5.0, "likewise from the direction (default: %(default)s)"),
    ):
        parser.add_argument(option, type=float, default=default, metavar="T", help=what)
    parser.add_argument("--starts", type=int, default=400, help="random starts (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the random starts (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    _add_set(parser, "a key of the file")
    parser.set_defaults(run=run_ik)


def _add_view(commands: Any) -> None:
    parser = commands.add_parser(
        "view",
        help="the robot in a browser, with a slider for every joint",
        description="A live 3-D page on this machine: the robot, its friction envelope and its error bound as the "
        "joints move. Nothing is loaded from the network.",
        epilog=VIEW_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", metavar="ROBOT.toml|SCENARIO.toml")
    parser.add_argument("--port", type=int, default=0, help="of 127.0.0.1 (default: a free one)")
    parser.add_argument("--no-browser", action="store_true", help="only print the page's address")
    _add_set(parser, "a key of the file")
    parser.set_defaults(run=run_view)


def _add_set(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help=f"change {what}, e.g. tube.2.poisson_ratio=0.28",
    )


if __name__ == "__main__":
    sys.exit(main())
