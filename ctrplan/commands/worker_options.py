"""Options that say who does the tasks of a study or a search, and the bar that shows how far they are."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from ctrplan.base.arguments import Whole
from ctrplan.commands.options import add_number
from ctrplan.commands.terminal import ProgressBar
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.studies.study.study import Doing, Where

MOST_WORKERS = 1024


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Adds --workers, --scheduler and --scheduler-file."""
    workers = "processes on this machine (default: one per core)"
    add_number(parser, "--workers", Whole(1, MOST_WORKERS), metavar="N", help=workers)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a dask cluster, such as tcp://10.0.0.5:8786")
    parser.add_argument("--scheduler-file", metavar="FILE", help="that a dask scheduler wrote its address into")


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
