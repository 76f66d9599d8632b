"""`ctrplan case`: from a patient's scan and points to a certified plan, in one command that can be taken up again."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import SEARCH_TIME, SEED, Number, Whole, in_plain_digits
from ctrplan.base.arrays import LONGEST_MM
from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.commands.options import add_number
from ctrplan.commands.terminal import ProgressBar
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.patients.case import Case, StepTold

NAMES = ("scenario", "bases", "placed", "plan", "slicer")
HANDED_ON = (
    *("frame", "file_frame", "unit", "repair", "series", "lumens", "avoids", "ignored", "robot"),
    *("phases", "motion_margin_mm", "margin_mm", "surface_error_mm"),
    *("tolerance_mm", "sheath_mm", "radius_mm", "cone_deg", "candidates", "bases", "seed", "from_step", "until"),
)
PATIENCE_S = 1.0  # before a progress bar shows up
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
    _add_places(parser)
    _add_roles(parser)
    _add_numbers(parser)
    parser.add_argument("--from", dest="from_step", choices=NAMES, help="make this step and all after it anew")
    parser.add_argument("--until", choices=NAMES, help="do no step after this one")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def _add_places(parser: argparse.ArgumentParser) -> None:
    where = "X Y Z in mm of --frame; or a file of markups, FILE:LABEL, or a label; several times for several"
    goal = "where the tip shall go, a line for a path to follow, a structure for its middle"
    for option, what in (("--target", goal), ("--entry", "the plate")):
        parser.add_argument(
            option, dest=option[2:], action="append", nargs="+", metavar="PLACE", help=f"{what}: {where}"
        )
    frames = ("RAS", "LPS")
    parser.add_argument("--frame", choices=frames, help="of the numbers in this command and of the case's files")
    parser.add_argument("--file-frame", choices=frames, help="of files that do not say theirs")
    parser.add_argument("--series", metavar="UID", help="of a DICOM folder that has several")
    parser.add_argument("--unit", choices=("mm", "cm", "m"), help="of meshes (default: mm)")
    repairs = "of openings of meshes: holes up to 2 mm from a vertex, also flat cuts of any size, none (default: holes)"
    parser.add_argument("--repair", choices=("holes", "caps", "off"), help=repairs)


def _add_roles(parser: argparse.ArgumentParser) -> None:
    roles = (
        ("--lumen", "lumens", "a structure that the robot stays inside of"),
        ("--avoid", "avoids", "a structure that it keeps clear of"),
        ("--ignore", "ignored", "a structure to leave out although its name is that of one of these"),
    )
    for option, name, what in roles:
        parser.add_argument(
            option, dest=name, action="append", metavar="[FILE:]NAME", help=f"{what}: segment, label, mesh, or range"
        )
    moves = "files of one structure that moves, one of each phase of breath or heart beat; the first names it"
    parser.add_argument("--phases", action="append", nargs="+", metavar="FILE", help=moves)
    parser.add_argument("--robot", metavar="FILE", help="default: three tubes on a drive that advances all of them")


def _add_numbers(parser: argparse.ArgumentParser) -> None:
    length, above = Number(0, LONGEST_MM, "mm"), Number(0, LONGEST_MM, "mm", above=True)
    numbers: tuple[tuple[str, Number | Whole, str, str], ...] = (
        (
            "--margin-mm",
            length,
            "D",
            "kept from every structure, besides what its surface may be off by (default: 0.5)",
        ),
        (
            "--motion-margin-mm",
            length,
            "D",
            "kept for places between phases (default: half the way from one to the next)",
        ),
        ("--surface-error-mm", length, "E", "what surfaces of volumes may be off by (default: from their voxels)"),
        ("--tolerance-mm", above, "T", "of the tip at a target (default: 1)"),
        ("--sheath-mm", above, "R", "inner radius of a straight sheath from the entry into the lumen"),
        ("--radius-mm", length, "R", "of the places around an entry where the robot may stand (default: 4)"),
        (
            "--cone-deg",
            Number(0, 90, "deg"),
            "A",
            "by which it may look past the target, or the entry's line (default: 20)",
        ),
        ("--candidates", Whole(1, 100_000), "N", "base poses that are looked at (default: 128)"),
        ("--bases", Whole(1, 1000), "N", "of them to plan from, until one has a plan (default: 3)"),
        ("--seed", SEED, "N", "of every search (default: 0)"),
        ("--time", SEARCH_TIME, "S", "seconds of the plan's search by the clock"),
    )
    for option, kind, metavar, what in numbers:
        add_number(parser, option, kind, metavar=metavar, help=what)


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError where a step fails."""
    places = {name: _places(f"--{name}", getattr(arguments, name)) for name in ("target", "entry")}
    with interrupt_event() as interrupted:  # imports take a second
        from ctrplan.patients.case import case

        if interrupted.is_set():
            raise KeyboardInterrupt
        terminal = sys.stderr is not None and sys.stderr.isatty()
        with ProgressBar(quiet=arguments.quiet or not terminal, patience_s=PATIENCE_S) as bar:
            found = case(
                arguments.output,
                arguments.inputs or None,
                targets=places["target"],
                entries=places["entry"],
                progress=bar.show,
                told=_tell,
                note=lambda text: print(f"ctrplan: {text.rstrip('.')}.", file=sys.stderr),
                interrupted=interrupted,
                time_s=arguments.time,
                **{name: getattr(arguments, name) for name in HANDED_ON},
            )
        print(_summary(found))
        return INTERRUPTED if found.interrupted else 0


def _places(option: str, given: Sequence[Sequence[str]] | None) -> list[Any] | None:
    """Three numbers each, or a name. Raises InputError."""
    if given is None:
        return None
    found: list[Any] = []
    for words in given:
        numbers = [in_plain_digits(word) for word in words]
        if len(words) == 3 and None not in numbers:
            found.append(numbers)
        elif len(words) == 1 and numbers[0] is None:
            found.append(words[0])
        else:
            raise InputError("must be three numbers X Y Z, or one name", key=option, value=" ".join(words))
    return found


def _tell(step: StepTold) -> None:
    number = NAMES.index(step.name) + 1
    time = f"{step.seconds:5.1f} s" if step.is_made else "       "
    print(f"[{number}/{len(NAMES)}] {step.name:9} {time}  {step.sentence}", flush=True)


def _summary(case: Case) -> str:
    seconds = sum(step.seconds for step in case.steps)
    lines = [f"{case.folder}: {seconds:.0f} s"]
    for what, name in (("report", "plan/report.html"), ("3D Slicer", "slicer/scene.mrml")):
        if (Path(case.folder) / name).exists() and not case.interrupted:
            lines.append(f"  {what:27} {case.folder / name}")
    lines.append(f"  {'after an edit of its files':27} ctrplan case -o {case.folder}")
    return "\n".join(lines)
