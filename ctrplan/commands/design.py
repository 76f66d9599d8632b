"""`ctrplan design`: which tubes should be made for a set of targets; the trade-off front of a search over stock."""

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
from ctrplan.commands.terminal import ProgressBar, aligned, tell_next, typed

if TYPE_CHECKING:
    from ctrplan.studies.design.tube_design import TubeDesigns

MOST_ROWS = 12
DESCRIPTION = (
    "Search over stock tubes, precurvatures and lengths; write the trade-off front (front.json, a "
    "robot file for each design), the table of all designs, report.html and the storage of Optuna."
)
EXAMPLES = """examples:
  ctrplan design scenarios/studies/design_ventricle.toml -o out
  ctrplan design DESIGN.toml -o out --set trials=1000 --workers 8

A design file says what can be made, and for which targets:
  scenario = "ventricle.toml"
  objectives = ["robust_mm", "reach", "stability"]
  targets = {within = "anatomy", count = 8, tolerance_mm = 2}
  [[stock]]                                   # tubes that can be bought, with tolerances
  name = "2.64 x 2.39"
  outer_diameter_mm = 2.64
  ...
  [[parameter]]                               # any key as in --set
  key = "robot.tube.3.section.2.curvature_y_per_m"
  low = 6
  high = 26
  tolerance_percent = 3

Ctrl-C and kills lose what is being done and nothing else: run again, and the search goes on. docs/tube_design.md.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("design", metavar="DESIGN.toml")
    add_output_option(parser, "folder of the search")
    add_worker_options(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    add_allow_outside_option(parser)
    add_set_option(parser, "the design file's key", "trials=1000")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code: 1 where no design reaches a target. Raises CtrplanError."""
    from ctrplan.studies.design.search import check_installed
    from ctrplan.studies.design.tube_design import TubeDesign
    from ctrplan.studies.study.study import in_words

    check_installed()
    where = chosen_workers(arguments)
    search = TubeDesign.read(arguments.design, arguments.overrides, allow_outside=arguments.allow_outside)
    took = in_words(search.expected_s / where.expected)
    print(
        f"ctrplan: {search.name}: {search.entry.trials:,} trials, {len(search.points_mm)} targets, "
        f"at most about {took} on {where.expected} workers.",
        file=sys.stderr,
    )
    with ProgressBar(quiet=arguments.quiet) as bar:
        result = search.run(
            arguments.output,
            workers=arguments.workers,
            scheduler=arguments.scheduler,
            scheduler_file=arguments.scheduler_file,
            yes=arguments.yes,
            progress=StageTeller(bar),
        )
    return _told(arguments, result)


def _told(arguments: argparse.Namespace, designs: TubeDesigns) -> int:
    from ctrplan.reports.study_page import write_design_report

    write_design_report(designs)
    print(_text(designs))
    print(f"ctrplan: results in {arguments.output}", file=sys.stderr)
    tell_next(f"open {typed(f'{arguments.output}/report.html')}; robots of the front are in {arguments.output}/robots")
    if designs.interrupted:
        print("ctrplan: interrupted; run the same command again, and the search goes on.", file=sys.stderr)
        return INTERRUPTED
    return 0 if designs.front else 1


def _text(designs: TubeDesigns) -> str:
    done, given_up, unable = designs.counts
    entries, objectives = designs.entries(), list(designs.search.entry.objectives)
    lines = [
        f"{designs.search.name}: {len(designs.archive.all):,} designs, {given_up:,} of them given up early, "
        f"{unable:,} can't be made or reach nothing; {len(entries)} on the front"
    ]
    names = [*objectives, *(name for name in designs.search.space.names)]
    rows = [["", *names]]
    for entry in entries[:MOST_ROWS]:
        values = {**entry, **entry["choices"]}
        rows.append([str(entry["number"]), *(_shown(values[name]) for name in names)])
    lines += aligned(rows)
    if len(entries) > MOST_ROWS:
        lines.append(f"... and {len(entries) - MOST_ROWS} more in front.json")
    if entries and entries[0]["tolerances"]:
        worst = entries[0]["tolerances"][0]
        lines.append(
            f"Of design 1's tolerances the costliest is that of {worst['name']}: "
            f"{worst['half_width']:.3g} {worst['unit']} cost {worst['costs_mm']:.3f} mm."
        )
    return "\n".join(lines)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
