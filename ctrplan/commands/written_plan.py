"""Arguments of the commands that read a written plan, and the plan with its robot solved anew."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from ctrplan.base.arguments import Whole
from ctrplan.commands.options import add_allow_outside_option, add_number, add_set_option
from ctrplan.commands.progress_bar import ProgressBar

if TYPE_CHECKING:
    from ctrplan.files.plan_file import WrittenPlan
    from ctrplan.reports.written_motion import WrittenMotion

STEPS = Whole(2, 2000)
PATIENCE_S = 1.0  # before a progress bar shows up


def add_plan_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the plan, its scenario, and what it was planned with."""
    parser.add_argument("plan", metavar="PLAN.json", help="a plan that ctrplan plan wrote, trajectory.csv beside it")
    parser.add_argument("scenario", metavar="SCENARIO.toml", nargs="?", help="where the plan's own one is elsewhere")
    parser.add_argument("--trajectory", metavar="CSV", help="the trajectory, if it is not beside the plan")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    add_allow_outside_option(parser)
    add_set_option(parser, "the scenario's key, or the robot's after robot., as the plan was made with")


def add_steps_option(parser: argparse.ArgumentParser, default: int) -> None:
    """Adds --steps."""
    add_number(parser, "--steps", STEPS, default=default, help="poses at equal times (default: %(default)s)")


def read_plan(arguments: argparse.Namespace) -> WrittenPlan:
    """The plan that the arguments name. Raises InputError."""
    from ctrplan.files.plan_file import load_plan

    return load_plan(
        arguments.plan,
        arguments.scenario,
        arguments.overrides,
        trajectory=arguments.trajectory,
        allow_outside=arguments.allow_outside,
    )


def progress_bar(arguments: argparse.Namespace) -> ProgressBar:
    """A bar on a terminal, for what takes long enough."""
    terminal = sys.stderr is not None and sys.stderr.isatty()
    return ProgressBar(quiet=arguments.quiet or not terminal, patience_s=PATIENCE_S)


def solved_motion(plan: WrittenPlan, steps: int, bar: ProgressBar) -> WrittenMotion:
    """The plan's robot at `steps` poses. Raises SolverError where it has none."""
    from ctrplan.reports.written_motion import written_motion

    return written_motion(plan, steps, lambda share: bar.show("solving", share))
