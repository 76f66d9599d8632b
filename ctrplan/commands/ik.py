"""`ctrplan ik`: every way found to bring the tip to a point, as a table or JSON."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import DIRECTION_TOLERANCE_DEG, LONGEST_MM, SEED, Number, Whole
from ctrplan.commands.options import add_allow_outside_option, add_number, add_set_option
from ctrplan.commands.terminal import aligned, finite, tell_next, telling, warn
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.storage.output_folder import output_folder, write_results

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.planning.reach import Configuration, Reach
    from ctrplan.scenario.scenario import Scenario

MOST_SHOWN = 10  # configurations in the table
OUTPUTS = ("ik.html",)
DESCRIPTION = (
    "Inverse kinematics: distinct configurations whose frictionless tip reaches a point, sorted by the "
    "worst-case friction error; with a scenario, also their clearance to its anatomy."
)
EXAMPLES = """examples:
  ctrplan ik scenarios/robots/three_tube.toml --tip-mm 34 -47 200
  ctrplan ik scenarios/vessel.toml --tip-mm 51 2 168 --direction 1 0 0.4 --direction-tolerance-deg 20 --json
  ctrplan ik scenarios/vessel.toml --tip-mm 51 2 168 -o out
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", metavar="ROBOT.toml|SCENARIO.toml")
    xyz: dict[str, Any] = {"nargs": 3, "metavar": ("X", "Y", "Z")}
    help_point = "the point; a scenario's is in the anatomy's frame"
    add_number(parser, "--tip-mm", Number(-LONGEST_MM, LONGEST_MM, "mm"), required=True, help=help_point, **xyz)
    add_number(parser, "--direction", Number(-1e6, 1e6), help="of the tip, any length", **xyz)
    there: dict[str, Any] = {"metavar": "T", "help": "distance from the point that counts as there (default: 0.1)"}
    add_number(parser, "--tolerance-mm", Number(1e-3, 1000, "mm"), default=0.1, **there)
    there["help"] = f"likewise from the direction (default: {DIRECTION_TOLERANCE_DEG})"
    add_number(parser, "--direction-tolerance-deg", Number(0, 180, "deg", above=True), **there)
    add_number(parser, "--starts", Whole(1, 100_000), default=400, help="random starts (default: %(default)s)")
    add_number(parser, "--seed", SEED, default=0, help="of the random starts (default: %(default)s)")
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for {OUTPUTS[0]}, the ways drawn and in a table")
    parser.add_argument("--all", action="store_true", help=f"list all configurations, not the best {MOST_SHOWN}")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    add_allow_outside_option(parser)
    add_set_option(parser, "a key of the file", "robot.tube.2.poisson_ratio=0.28")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError, NoAnswerError where the point is out of reach."""
    import numpy as np

    from ctrplan.files.scenario_file import load_robot_or_scenario
    from ctrplan.pipeline.chain import plan_range_notes
    from ctrplan.planning.inverse_kinematics import inverse_kinematics, refuse_wrong_unit

    scenario = load_robot_or_scenario(arguments.file, arguments.overrides, allow_outside=arguments.allow_outside)
    _check_direction(arguments)
    doubt = refuse_wrong_unit(scenario, arguments.tip_mm, "mm", "--tip-mm")
    folder = output_folder(arguments.output, OUTPUTS) if arguments.output is not None else None
    warn([*scenario.warnings, *([doubt] if doubt else [])])
    tolerance_deg = arguments.direction_tolerance_deg
    with telling("looking for every way there, and for other shapes of the robot at the same joints"):
        result = inverse_kinematics(
            scenario,
            np.multiply(arguments.tip_mm, 1e-3),
            arguments.direction,
            tolerance_m=arguments.tolerance_mm * 1e-3,
            direction_tolerance_rad=None if tolerance_deg is None else math.radians(tolerance_deg),
            starts=arguments.starts,
            seed=arguments.seed,
        )
        outcome, branches = result.solutions, list(result.branches)
        warn(
            plan_range_notes(scenario.robot, np.array([c.joints for c in outcome.configurations or [outcome.nearest]]))
        )
        print(
            json.dumps(_json(scenario, outcome, branches), indent=1)
            if arguments.json
            else _text(scenario, outcome, branches, shown=len(branches) if arguments.all else MOST_SHOWN)
        )
    if not outcome.configurations:
        raise NoAnswerError(f"--tip-mm: {_unreached(scenario, outcome, arguments)}.")
    if folder is not None:
        _write(folder, scenario, outcome, branches)
    if not arguments.json:
        tell_next("joint values of a row as [goal] joints = {...} of a scenario, and ctrplan plan")
    return 0


def _write(folder: Path, scenario: Scenario, reach: Reach, branches: list[int]) -> None:
    from ctrplan.reports.reach_page import reach_report_html, reach_scene

    scene = reach_scene(scenario, reach, branches)  # writers solve nothing
    write_results(folder, {OUTPUTS[0]: reach_report_html(scene)})
    print(f"ctrplan: written to {folder / OUTPUTS[0]}", file=sys.stderr)  # standard output may be JSON


def _check_direction(arguments: argparse.Namespace) -> None:
    """Raises InputError for a direction that is none."""
    allowed_deg = arguments.direction_tolerance_deg
    if allowed_deg is not None and arguments.direction is None:
        raise InputError("goes with --direction", key="--direction-tolerance-deg", value=allowed_deg)
    if arguments.direction is not None and not any(arguments.direction):
        raise InputError("must not be zero", key="--direction", value=arguments.direction)


def _text(scenario: Scenario, reach: Reach, branches: list[int], shown: int) -> str:
    """A table of the best `shown` of them, the best of each branch before others, and how many more there are."""
    count, names = len(reach.configurations), scenario.robot.drive.names
    many = f"{count} configurations" if count != 1 else "1 configuration"
    in_branches = len(set(branches))
    head = (
        f"{scenario.name}: {many} in {in_branches} {'branch' if in_branches == 1 else 'branches'}, by branch, lowest "
        f"worst-case error first"
    )
    if not count:
        return f"{scenario.name}: no configuration"
    units = [joint.unit for joint in scenario.robot.drive.joints]
    header = ["branch", *(f"{n} ({u})" for n, u in zip(names, units, strict=True))]
    header += ["worst case (mm)", "(deg)", "stability", "clearance (mm)", "tip error (mm)", *_play_header(scenario)]
    chosen = _best(branches, shown)
    rows = [_row(scenario, reach.configurations[k], branches[k]) for k in chosen]
    left = count - len(chosen)
    more = [f"and {left} more: --all lists them, -o DIR draws them"] if left else []
    several = [apart for k in chosen if (apart := _other_shape_m(scenario, reach.configurations[k]))]
    if several:
        which = "one of these stands" if len(several) == 1 else f"{len(several)} of these stand"
        more.append(
            f"{which} in one of several stable shapes (another up to {max(several) * 1e3:.1f} mm away), where whole "
            f"turns may lead; ctrplan bound names them"
        )
    return "\n".join([head, *aligned([header, *rows]), *more])


def _other_shape_m(scenario: Scenario, c: Configuration) -> float:
    """[m] from the tip to that of the farthest other stable shape at the same joints; 0 without one."""
    from ctrplan.mechanics.equilibria import other_shapes

    others = other_shapes(scenario.robot, *scenario.robot.drive.collars(c.joints), c.tip_m)
    return others[-1][0] if others else 0.0


def _best(branches: list[int], shown: int) -> list[int]:
    """Numbers of the configurations that are shown, branch by branch: the best of each, then the next of each.

    Configurations come lowest bound first.
    """
    rank = [branches[:k].count(branch) for k, branch in enumerate(branches)]
    kept = sorted(range(len(branches)), key=lambda k: (rank[k], k))[:shown]
    first = {branch: branches.index(branch) for branch in set(branches)}
    return sorted(kept, key=lambda k: (first[branches[k]], k))


def _row(scenario: Scenario, c: Configuration, branch: int) -> list[str]:
    clearance = "free space" if math.isinf(c.clearance_m) else f"{c.clearance_m * 1e3:.2f}"
    joints = [f"{value:.2f}" for value in _shown(scenario, c.joints)]
    figures = [f"{c.bound_m * 1e3:.3f}", f"{math.degrees(c.bound_rad):.2f}", f"{c.stability:.2f}", clearance]
    return [
        str(branch + 1),
        *joints,
        *figures,
        f"{c.tip_error_m * 1e3:.3f}",
        *([f"{c.play_m * 1e3:.3f}"] if _play_header(scenario) else []),
        f"not valid: {c.reason}" if c.reason else "",
    ]


def _play_header(scenario: Scenario) -> list[str]:
    """The column of what play moves the tip by besides, for robots that have play."""
    return [] if scenario.robot.drive.play is None else ["play (mm)"]


def _shown(scenario: Scenario, joints: Array) -> list[float]:
    """Joint values in deg and mm."""
    return [float(q) / joint.si_per_unit for q, joint in zip(joints, scenario.robot.drive.joints, strict=True)]


def _json(scenario: Scenario, reach: Reach, branches: list[int]) -> dict[str, Any]:
    rows = [{"branch": b + 1, **_entry(scenario, c)} for c, b in zip(reach.configurations, branches, strict=True)]
    return {
        "name": scenario.name,
        "reachable": bool(rows),
        "branches": len(set(branches)),
        "configurations": rows,
        "nearest": _entry(scenario, reach.nearest),
    }


def _entry(scenario: Scenario, c: Configuration) -> dict[str, Any]:
    names = scenario.robot.drive.names
    units = [joint.unit for joint in scenario.robot.drive.joints]
    return {
        "joints": {n: {u: x} for n, u, x in zip(names, units, _shown(scenario, c.joints), strict=True)},
        "tip_mm": _tip_mm(scenario, c),
        "tip_tangent": (scenario.base_R @ c.tangent).tolist(),
        "tip_error_mm": finite(c.tip_error_m * 1e3),
        "direction_error_deg": math.degrees(c.turned_rad),
        "bound_position_mm": finite(c.bound_m * 1e3),
        "bound_tangent_deg": finite(math.degrees(c.bound_rad)),
        "play_mm": finite(c.play_m * 1e3),
        "stability": finite(c.stability),
        "other_shape_mm": _other_shape_m(scenario, c) * 1e3 or None,
        "max_strain": finite(c.max_strain),
        "clearance_mm": finite(c.clearance_m * 1e3),
        "valid": c.valid,
        "reason": c.reason,
    }


def _tip_mm(scenario: Scenario, c: Configuration) -> list[float]:
    return [round(float(x), 4) for x in (scenario.base_R @ c.tip_m + scenario.base_position_m) * 1e3]


def _unreached(scenario: Scenario, reach: Reach, arguments: argparse.Namespace) -> str:
    nearest = reach.nearest
    if nearest.tip_error_m <= reach.tolerance_m:
        turned = math.degrees(nearest.turned_rad)
        allowed = arguments.direction_tolerance_deg or DIRECTION_TOLERANCE_DEG
        return f"reached, but at best {turned:.1f} deg from --direction, --direction-tolerance-deg = {allowed:g}"
    away_mm, where = nearest.tip_error_m * 1e3, [round(x, 2) for x in _tip_mm(scenario, nearest)]
    return f"out of reach, the nearest tip found is {away_mm:.3g} mm away at {where} mm"
