"""`ctrplan study`: thousands of tasks over a robot or scenario, as a table and a page; what is missing is done."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from ctrplan.base.long_work import INTERRUPTED
from ctrplan.commands.options import (
    StageTeller,
    add_allow_outside_option,
    add_output_option,
    add_set_option,
    add_worker_options,
    chosen_workers,
)
from ctrplan.commands.terminal import ProgressBar, tell_next, typed

if TYPE_CHECKING:
    from ctrplan.studies.study.study import Outcome, Study, Where

MOST_INPUTS = 3  # that a line of the terminal names; the table has all of them

DESCRIPTION = (
    "Do a task with every combination of what a study varies; write the table "
    "(results.parquet, or results.csv without pyarrow), report.html, and the plans that are asked for."
)
EXAMPLES = """examples:
  ctrplan study STUDY.toml -o out
  ctrplan study STUDY.toml -o out --set targets.step_mm=2 --add
  ctrplan study STUDY.toml -o out --workers 8
  ctrplan study STUDY.toml -o out --scheduler tcp://10.0.0.5:8786

A study says what is varied (any key as in --set, targets, base poses) and what is done with each combination:
  scenario = "scenarios/ventricle.toml"
  task = {kind = "ik"}                       # bound, ik, plan, simulate, diagnose, or a function of yours
  targets = {within = "anatomy", step_mm = 5}
  [[vary]]
  key = "robot.contact.1.friction_coefficient"
  values = [0.1, 0.2, 0.3]

Ctrl-C and kills lose what is being done and nothing else: run again, and what is missing is done. docs/studies.md.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("study", metavar="STUDY.toml")
    add_output_option(parser, "folder of the study")
    add_worker_options(parser)
    parser.add_argument("--add", action="store_true", help="keep what the folder has of another study beside this one")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    add_allow_outside_option(parser)
    add_set_option(parser, "the study's key", "targets.step_mm=2")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code: 1 where no task has an answer. Raises CtrplanError."""
    from ctrplan.studies.study.study import Study, refuse_endless, run_study

    where = chosen_workers(arguments)
    study = Study.read(arguments.study, arguments.overrides, allow_outside=arguments.allow_outside)
    refuse_endless(study, where, arguments.yes)
    print(_beforehand(study, where), file=sys.stderr)
    with ProgressBar(quiet=arguments.quiet) as bar:
        teller = StageTeller(bar)
        result = run_study(study, arguments.output, where, add=arguments.add, yes=arguments.yes, progress=teller)
    _write_report(study, result)
    print(_summary(study, result))
    tell_next(
        f"open {typed(f'{arguments.output}/report.html')}; ctrplan.load_study({str(arguments.output)!r}) in Python"
    )
    if result.interrupted:
        return INTERRUPTED
    return 0 if result.table.done.any() else 1


def _beforehand(study: Study, where: Where) -> str:
    """What will be done, and about how long that takes."""
    from ctrplan.studies.study.study import in_words

    core_s = study.count * study.task_s
    workers = "1 worker" if where.expected == 1 else f"{where.expected} workers"
    takes = f"{in_words(core_s / where.expected)} on {workers}"
    if where.scheduler or where.scheduler_file:  # whose workers come and go
        takes = f"{in_words(core_s)} of one core, divided by the cluster's workers"
    tasks = "1 task" if study.count == 1 else f"{study.count:,} tasks"
    return f"ctrplan: {study.name}: {tasks} ({study.kind.kind}), about {takes}."


def _write_report(study: Study, outcome: Outcome) -> None:
    from ctrplan.reports.study_page import write_study_report

    write_study_report(study, outcome.table)


def _summary(study: Study, outcome: Outcome) -> str:
    from collections import Counter

    table = outcome.table
    status = Counter(table.columns["status"])
    lines = [f"{study.name}: {len(table):,} of {outcome.count:,} tasks, {outcome.did:,} of them done now"]
    lines.append(f"  {'status':27} {', '.join(f'{count:,} {name}' for name, count in status.most_common())}")
    for row in table.rows():
        if row["status"] != "done":
            lines.append(f"  {'the first of those':27} task {row['index']}: {row['reason']}")
            break
    lines += [f"  {label:27} {text}" for label, text in _extremes(study, outcome).items()]
    lines.append(f"  {'written to':27} {outcome.store.folder}/{outcome.file.name}, report.html")
    if outcome.interrupted:
        lines.append("  Interrupted; run it again to go on.")
    return "\n".join(lines)


def _extremes(study: Study, outcome: Outcome) -> dict[str, str]:
    """The best and the worst row."""
    from ctrplan.studies.study.table import extremes, judged_by

    column, rows = judged_by(study), list(outcome.table.rows())
    inputs = [name for axis in study.axes for name in axis.at(0).inputs]
    texts = {}
    for label, k in zip((f"least {column}", "largest"), extremes(rows, column), strict=False):
        where = ", ".join(f"{name} = {_shown(rows[k].get(name))}" for name in inputs[:MOST_INPUTS])
        more = ", ..." if len(inputs) > MOST_INPUTS else ""
        texts[label] = f"{rows[k][column]:.4g}, task {rows[k]['index']}: {where}{more}"
    return texts


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
