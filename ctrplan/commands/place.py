"""`ctrplan place`: base poses from which a scenario's targets are reached, ranked; writes the scenario of one."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import CANDIDATES, CONFIRMED, LONGEST_MM, SEED, Number, Whole
from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.commands.options import add_allow_outside_option, add_number, add_set_option
from ctrplan.commands.terminal import PATIENCE_S, ProgressBar, aligned, finite, tell_next, typed, warn
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.storage.output_folder import require_kept

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.planning.base_pose import BasePose
    from ctrplan.planning.place import Placement
    from ctrplan.scenario.scenario import Scenario

PLANS = 3
HEADER = ("", "position (mm)", "looks along", "tilt (deg)", "reached", "at worst (mm)", "tolerances", "clearance (mm)")
DESCRIPTION = (
    "Try base poses on a patch of skin or along an opening, cheaply first, the best ones by inverse "
    "kinematics with bounds and clearances of all corners; print them ranked and write the scenario of the best."
)
EXAMPLES = """examples:
  ctrplan place scenarios/ventricle.toml
  ctrplan place scenarios/ventricle.toml --radius-mm 4 --cone-deg 20 --plan 3 -o ventricle_placed.toml
  ctrplan place SCENARIO.toml --center-mm 0 -12 5 --along-mm 0 12 5 --radius-mm 2   # along an opening
  ctrplan place SCENARIO.toml --pick 2                                              # the second best is written

Ranked by: valid start, a plan (with --plan), targets reached, the worst error beside its tolerance, clearance.
A straight approach is often a bad one: pre-curved tubes have to cancel on it, which loads friction most.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("scenario", metavar="SCENARIO.toml")
    parser.add_argument("-o", "--output", metavar="FILE", help="the scenario (default: SCENARIO_placed.toml beside it)")
    add_number(
        parser, "--pick", Whole(1, 1000), default=1, metavar="N", help="write number N of the table (default: 1)"
    )
    xyz: dict[str, Any] = {"nargs": 3, "metavar": ("X", "Y", "Z")}
    point, radius = Number(-LONGEST_MM, LONGEST_MM, "mm"), Number(0, 1000, "mm")
    add_number(parser, "--center-mm", point, help="middle of the patch (default: the scenario's base)", **xyz)
    add_number(parser, "--along-mm", point, help="other end of an opening that begins at the middle", **xyz)
    around = "of the patch, across the way to the targets (default: %(default)g)"
    add_number(parser, "--radius-mm", radius, default=10.0, metavar="R", help=around)
    cone = "half angle of the cone of directions about that way (default: %(default)g)"
    add_number(parser, "--cone-deg", Number(0, 90, "deg"), default=30.0, metavar="A", help=cone)
    tried = "poses with a valid start that are looked at (default: %(default)s)"
    add_number(parser, "--candidates", Whole(1, 100_000), default=CANDIDATES, metavar="N", help=tried)
    confirm = "of them by bounds in all corners (default: %(default)s)"
    add_number(parser, "--confirm", Whole(1, 1000), default=CONFIRMED, metavar="N", help=confirm)
    plans = f"also plan from the best N (default where given: {PLANS})"
    add_number(parser, "--plan", Whole(1, 1000), nargs="?", const=PLANS, default=0, metavar="N", help=plans)
    add_number(parser, "--seed", SEED, default=0, help="of poses and solves (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    add_allow_outside_option(parser)
    add_set_option(parser, "a key of the scenario, or robot.KEY of its robot", "goal.tolerance_mm=2")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError, NoAnswerError where no pose reaches a target."""
    with interrupt_event() as interrupted:  # imports take a second
        from ctrplan.files.scenario_file import load_scenario
        from ctrplan.planning.place import place

        scenario = load_scenario(arguments.scenario, arguments.overrides, allow_outside=arguments.allow_outside)
        file = _output(arguments)
        warn(scenario.warnings)
        if interrupted.is_set():
            raise KeyboardInterrupt
        with ProgressBar(quiet=arguments.quiet, patience_s=PATIENCE_S) as bar:
            result = place(
                scenario,
                center_m=_metres(arguments.center_mm),
                along_m=_metres(arguments.along_mm),
                radius_m=arguments.radius_mm * 1e-3,
                cone_rad=math.radians(arguments.cone_deg),
                candidates=arguments.candidates,
                confirmed=arguments.confirm,
                plans=arguments.plan,
                seed=arguments.seed,
                progress=bar.show,
                interrupted=interrupted,
            )
        print(json.dumps(_json(result), indent=1) if arguments.json else _text(scenario, result))
        outside = _write(arguments, file, _picked(arguments, scenario, result))
        if not arguments.json:
            tell_next(f"ctrplan plan {typed(file)}{' --allow-outside' if outside else ''} -o out")
        return INTERRUPTED if result.interrupted else 0


def _output(arguments: argparse.Namespace) -> Path:
    """The file to be written, in a folder that exists. Raises InputError."""
    source = Path(arguments.scenario)
    given = arguments.output
    file = source.with_name(f"{source.stem}_placed.toml") if given is None else Path(given)
    if not given and given is not None or file.is_dir() or not file.parent.is_dir():
        raise InputError("must be a file in a folder that exists", key="--output", value=str(given))
    if not os.access(file.parent, os.W_OK):
        raise InputError("lies in a folder that is not writable", key="--output", value=str(file))
    require_kept(file, [arguments.scenario])
    return file


def _metres(point_mm: list[float] | None) -> list[float] | None:
    return None if point_mm is None else [x * 1e-3 for x in point_mm]


def _picked(arguments: argparse.Namespace, scenario: Scenario, placement: Placement) -> BasePose:
    if arguments.pick > len(placement.poses):
        raise InputError(f"there are {len(placement.poses)} poses", key="--pick", value=arguments.pick)
    pose: BasePose = placement.poses[arguments.pick - 1]
    if not pose.reached:
        raise NoAnswerError(f"{scenario.path}: base pose {arguments.pick} reaches no target: {pose.reason}.")
    return pose


def _write(arguments: argparse.Namespace, file: Path, pose: BasePose) -> bool:
    """Writes the scenario with a pose; returns whether it names files outside its folder."""
    from ctrplan.files.file_content import names_files_outside, placed_scenario
    from ctrplan.storage.output_folder import write_atomically
    from ctrplan.storage.toml_document import read_document

    own = [text for text in arguments.overrides if not text.lstrip().startswith("robot.")]
    document = read_document(arguments.scenario, own)
    write_atomically(file, placed_scenario(document, pose, file))
    outside = names_files_outside(document, file)
    notes = ["; it needs --allow-outside there"] if outside else []
    notes += ["; --set robot... is not part of it, give it again"] if len(own) < len(arguments.overrides) else []
    print(f"ctrplan: base pose {arguments.pick} written to {file}{''.join(notes)}", file=sys.stderr)
    return outside


def _text(scenario: Scenario, placement: Placement) -> str:
    rows = [HEADER, *(_row(str(k), pose) for k, pose in enumerate(placement.poses, start=1))]
    if not any(pose.is_own for pose in placement.poses):
        rows.append(_row("", placement.own))
    return "\n".join([f"{scenario.name}: {placement.sentence}", *aligned(rows)])


def _row(number: str, pose: BasePose) -> tuple[str, ...]:
    count, reached = len(pose.targets), pose.reached
    worst_mm = max((target.worst_m for target in pose.targets if target.best), default=math.inf) * 1e3
    clearance = "free space" if pose.clearance_m == math.inf else f"{pose.clearance_m * 1e3:.2f}"
    notes = ["as it is"] if pose.is_own else []
    notes += [f"planned, {pose.plan.certificate.cost_mm:.0f} mm"] if pose.plan else []
    notes += [pose.reason] if pose.reason else []
    return (
        number,
        _vector(pose.position_m * 1e3, 1),
        _vector(pose.direction, 3),
        f"{math.degrees(pose.tilt_rad):.1f}",
        f"{reached} of {count}",
        f"{worst_mm:.2f}" if reached else "",
        f"{pose.share:.2f}" if reached else "",
        clearance if reached else "",
        "; ".join(notes),
    )


def _vector(numbers: Array, digits: int) -> str:
    return " ".join(f"{x + 0.0:.{digits}f}" for x in numbers.round(digits).tolist())


def _json(placement: Placement) -> dict[str, Any]:
    return {
        "sentence": placement.sentence,
        "drawn": placement.drawn,
        "clear": placement.clear,
        "promising": placement.promising,
        "poses": [_entry(pose) for pose in placement.poses],
        "own": _entry(placement.own),
    }


def _entry(pose: BasePose) -> dict[str, Any]:
    return {
        "position_mm": (pose.position_m * 1e3).tolist(),
        "direction": pose.direction.tolist(),
        "tilt_deg": math.degrees(pose.tilt_rad),
        "is_own": pose.is_own,
        "reached": pose.reached,
        "targets": [
            {
                "place": target.goal.place,
                "valid": target.valid,
                "worst_mm": finite(target.worst_m * 1e3),
                "clearance_mm": None if target.best is None else finite(target.best.clearance_m * 1e3),
                "reason": target.reason,
            }
            for target in pose.targets
        ],
        "clearance_mm": finite(pose.clearance_m * 1e3),
        "planned": pose.plan is not None,
        "reason": pose.reason,
    }
