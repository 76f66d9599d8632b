"""`ctrplan case`: from a patient's scan and points to a certified plan, in one command that can be taken up again."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import in_plain_digits
from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.commands.options import add_options_of
from ctrplan.commands.terminal import PATIENCE_S, ProgressBar, tell_next, typed
from ctrplan.errors import InputError
from ctrplan.patients.request import OPTIONS, STEP_NAMES

if TYPE_CHECKING:
    from ctrplan.patients.case import Case, StepReport

DESCRIPTION = (
    "Make a scenario of images, label maps, surfaces and points, propose where the robot stands, plan, "
    "and write report and 3D Slicer's scene. Every step's result is a file that can be edited."
)
EXAMPLES = """examples:
  ctrplan case patient/ --target 17.3 3 88 --entry 0 0 0 --frame LPS --lumen airway -o case
  ctrplan case seg.seg.nrrd points.mrk.json --lumen trachea --avoid vessels -o case   # points called target and entry
  ctrplan case ct_labels.nii.gz --lumen 1 --avoid 2 --target nodule.fcsv --entry mouth.fcsv --robot robot.toml -o case
  ctrplan case -o case                    # after an edit of case/scenario.toml, bases.csv or placed.toml: what follows
  ctrplan case -o case --from bases --radius-mm 8

Written into DIR, a step each; edit a file and run again, and only what depends on it is done anew:
  scenario  scenario.toml, robot.toml, more_entries.csv   structures, roles, margins, targets, start
  bases     bases.csv                                     where the robot could stand, best first
  placed    placed.toml                                   the scenario with its base at the first row
  plan      plan/                                         plan.json, trajectory, report.html, plan.png
  slicer    slicer/scene.mrml                             opens in 3D Slicer
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument(
        "inputs", metavar="FILES", nargs="*", help="images, meshes, .mrk.json and .fcsv, or folders of them"
    )
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="the case's folder")
    where = "X Y Z in mm of --frame; or a file of markups, FILE:LABEL, or a label; several times for several"
    goal = "where the tip shall go, a line for a path to follow, a structure for its middle"
    for option, what in (("--target", goal), ("--entry", "the plate")):
        parser.add_argument(option, action="append", nargs="+", metavar="PLACE", help=f"{what}: {where}")
    moves = "files of one structure that moves, one of each phase of breath or heart beat; the first names it"
    parser.add_argument("--phases", action="append", nargs="+", metavar="FILE", help=moves)
    add_options_of(parser, OPTIONS)
    parser.add_argument("--from", dest="from_step", choices=STEP_NAMES, help="make this step and all after it anew")
    parser.add_argument("--until", choices=STEP_NAMES, help="do no step after this one")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError where a step fails."""
    places = {name: _places(f"--{name}", getattr(arguments, name)) for name in ("target", "entry")}
    with interrupt_event() as interrupted:  # imports take a second
        from ctrplan.patients.case import case

        if interrupted.is_set():
            raise KeyboardInterrupt
        with ProgressBar(quiet=arguments.quiet, patience_s=PATIENCE_S) as bar:
            result = case(
                arguments.output,
                arguments.inputs or None,
                targets=places["target"],
                entries=places["entry"],
                progress=bar.show,
                on_step=_tell,
                note=lambda text: print(f"ctrplan: {text.rstrip('.')}.", file=sys.stderr),
                interrupted=interrupted,
                phases=arguments.phases,
                from_step=arguments.from_step,
                until=arguments.until,
                **{name: getattr(arguments, name) for name in OPTIONS},
            )
        print(_summary(result))
        tell_next(
            f"open {typed(f'{arguments.output}/slicer/scene.mrml')} in 3D Slicer, "
            f"or change {arguments.output}/scenario.toml"
        )
        return INTERRUPTED if result.interrupted else 0


def _places(option: str, given: Sequence[Sequence[str]] | None) -> list[Any] | None:
    """Three numbers each, or a name. Raises InputError."""
    if given is None:
        return None
    results: list[Any] = []
    for words in given:
        numbers = [in_plain_digits(word) for word in words]
        if len(words) == 3 and None not in numbers:
            results.append(numbers)
        elif len(words) == 1 and numbers[0] is None:
            results.append(words[0])
        else:
            raise InputError("must be three numbers X Y Z, or one name", key=option, value=" ".join(words))
    return results


def _tell(step: StepReport) -> None:
    number = STEP_NAMES.index(step.name) + 1
    time = f"{step.seconds:5.1f} s" if step.is_made else "       "
    print(f"[{number}/{len(STEP_NAMES)}] {step.name:9} {time}  {step.sentence}", flush=True)


def _summary(case: Case) -> str:
    seconds = sum(step.seconds for step in case.steps)
    lines = [f"{case.folder}: {seconds:.0f} s"]
    for what, name in (("report", "plan/report.html"), ("3D Slicer", "slicer/scene.mrml")):
        if (Path(case.folder) / name).exists() and not case.interrupted:
            lines.append(f"  {what:27} {case.folder / name}")
    lines.append(f"  {'after an edit of its files':27} ctrplan case -o {typed(case.folder)}")
    return "\n".join(lines)
