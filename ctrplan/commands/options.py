"""Options and arguments that several commands share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import (
    LONGEST_MM,
    MOST_TURNS_DEG,
    Choice,
    Number,
    Option,
    Texts,
    Whole,
    in_plain_digits,
    require,
)
from ctrplan.base.long_work import MOST_THREADS
from ctrplan.commands.terminal import ProgressBar, warn
from ctrplan.errors import InputError
from ctrplan.storage.output_folder import DEFAULT

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.files.plan_file import WrittenPlan
    from ctrplan.reports.plan_scene import WrittenMotion
    from ctrplan.studies.study.study import Doing, Where


def add_set_option(parser: argparse.ArgumentParser, what: str, example: str = "tube.2.poisson_ratio=0.28") -> None:
    """Adds --set KEY=VALUE, which changes any key of an input file."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help=f"change {what}, e.g. {example}",
    )


def add_allow_outside_option(parser: argparse.ArgumentParser) -> None:
    """Adds --allow-outside, for scenarios whose robot and meshes lie elsewhere."""
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="read files that the scenario names although they lie outside its folder",
    )


def add_output_option(
    parser: argparse.ArgumentParser, what: str = "folder for the results", default: str = DEFAULT
) -> None:
    """Adds -o/--output, a folder."""
    parser.add_argument("-o", "--output", metavar="DIR", default=default, help=f"{what} (default: %(default)s)")


def add_joint_options(parser: argparse.ArgumentParser) -> None:
    """Adds --theta-deg and --l-mm, a number per tube; configuration() reads them."""
    turns = Number(-MOST_TURNS_DEG, MOST_TURNS_DEG, "deg")
    travel = Number(-LONGEST_MM, LONGEST_MM, "mm")
    for option, kind, metavar, what in (
        ("--theta-deg", turns, "DEG", "commanded base rotations, outermost tube first"),
        ("--l-mm", travel, "MM", "commanded base translations, outermost tube first, <= 0"),
    ):
        add_number(parser, option, kind, nargs="+", required=True, metavar=metavar, help=what)


def add_number(
    parser: argparse.ArgumentParser,
    option: str,
    kind: Number | Whole,
    *,
    short: str = "",
    **keys: Any,
) -> None:
    """Adds an option whose values, one or with nargs several, are numbers of a kind; keys are those of argparse.

    A value that is none is refused with the option, the value, the unit and the range.
    """

    def read(text: str) -> float:
        value = in_plain_digits(text, isinstance(kind, Whole))
        require(option, text if value is None else value, kind)
        return value  # type: ignore[return-value]  # `require` refuses what is no number

    parser.add_argument(*([short] if short else []), option, type=read, **keys)


def add_options_of(parser: argparse.ArgumentParser, options: Mapping[str, Option]) -> None:
    """Adds an option for each key of a TypedDict, as `options_of` gives them. None stands for what is not said."""
    for name, option in options.items():
        flag = option.flag or f"--{name.replace('_', '-')}"
        keys: dict[str, Any] = {"dest": name, "metavar": option.metavar, "help": option.help}
        if isinstance(option.kind, (Number, Whole)):
            add_number(parser, flag, option.kind, **keys)
        elif isinstance(option.kind, Choice):
            parser.add_argument(flag, choices=option.kind.options, **keys)
        else:
            parser.add_argument(flag, action="append" if isinstance(option.kind, Texts) else "store", **keys)


def configuration(arguments: argparse.Namespace, n: int) -> tuple[Array, Array]:
    """Commanded rotations (n,) [rad] and translations (n,) [m] of the command line.

    Raises InputError unless there is a number per tube.
    """
    import numpy as np

    for key, values in (("--theta-deg", arguments.theta_deg), ("--l-mm", arguments.l_mm)):
        if len(values) != n:
            raise InputError(f"needs {n} values, one per tube, outermost first", key=key, value=values)
    return np.radians(arguments.theta_deg), np.multiply(arguments.l_mm, 1e-3)


USUAL_PORT = 18944


def add_igtl_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Adds --igtl."""
    add_number(
        parser,
        "--igtl",
        Whole(0, 65535),
        metavar="PORT",
        help=f"send {what} over OpenIGTLink, on this port of 127.0.0.1 (usually {USUAL_PORT}; 0: a free one)",
    )


STEPS = Whole(2, 2000)


def refuse_alone(given: Mapping[str, object], other: str) -> None:
    """Raises InputError for options that say nothing without another one, and were given; None and [] were not."""
    for option, value in given.items():
        if value is not None and value != []:
            raise InputError(f"goes with {other} only", key=option, value=value)


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
    """The plan that the arguments name, with a warning for each file that was changed. Raises InputError."""
    from ctrplan.files.plan_file import load_plan

    plan = load_plan(
        arguments.plan,
        arguments.scenario,
        arguments.overrides,
        trajectory=arguments.trajectory,
        allow_outside=arguments.allow_outside,
    )
    warn(plan.warnings)
    return plan


def solved_motion(plan: WrittenPlan, steps: int, bar: ProgressBar) -> WrittenMotion:
    """The plan's robot at `steps` poses. Raises SolverError where it has none."""
    from ctrplan.reports.plan_scene import written_motion

    return written_motion(plan, steps, lambda share: bar.show("solving", share))


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Adds --workers, --scheduler, --scheduler-file and --yes."""
    workers = "processes on this machine (default: one per core)"
    add_number(parser, "--workers", Whole(1, MOST_THREADS), metavar="N", help=workers)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a dask cluster, such as tcp://10.0.0.5:8786")
    parser.add_argument("--scheduler-file", metavar="FILE", help="that a dask scheduler wrote its address into")
    parser.add_argument("--yes", action="store_true", help="also where it takes more than a week")


def chosen_workers(arguments: argparse.Namespace) -> Where:
    """Who does the tasks. Raises InputError for options that contradict each other."""
    from ctrplan.studies.study.study import Where

    for first, second in (("--scheduler", "--scheduler-file"), ("--scheduler", "--workers")):
        values = [getattr(arguments, name[2:].replace("-", "_")) for name in (first, second)]
        if all(value is not None for value in values):
            raise InputError(f"does not go with {first}", key=second, value=values[1])
    return Where(None, arguments.workers, arguments.scheduler, arguments.scheduler_file)


class StageTeller:
    """Shows how far the tasks are, and once where their workers can be watched."""

    def __init__(self, bar: ProgressBar) -> None:
        """Shows nothing yet."""
        self.bar = bar
        self.noted = ""

    def __call__(self, doing: Doing) -> None:
        """Shows it."""
        from ctrplan.studies.study.study import in_words

        if doing.note and doing.note != self.noted:
            self.noted = doing.note
            print(f"ctrplan: the workers can be watched at {doing.note}", file=sys.stderr)
        left = "" if doing.left_s is None else f", {in_words(doing.left_s)} left"
        note = f"{doing.done:,} of {doing.count:,}{left}" if doing.stage != "workers" else ""
        self.bar.show(doing.stage, doing.share, note)
