"""`ctrplan bound`: the friction bound at one configuration, as text or JSON; with --sweep see sweep.py beside."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from ctrplan.commands.options import add_joint_options, add_set_option, configuration
from ctrplan.errors import InputError, NoAnswerError, SolverError
from ctrplan.storage.output_folder import DEFAULT as DEFAULT_FOLDER

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.mechanics.shapes import Bound, Shape
    from ctrplan.robot.robot import Robot

EXAMPLES = """examples:
  ctrplan bound scenarios/robots/three_tube.toml --theta-deg 0 90 180 --l-mm 0 -17 -62.8
  ctrplan bound scenarios/robots/table_1_pair.toml --theta-deg 0 180 --l-mm 0 -17 \
--set contact.1.friction_coefficient=0.4
  ctrplan bound scenarios/robots/three_tube.toml --theta-deg 0 90 0 --l-mm 0 -17 -62.8 --sweep theta_3=0:360:121 -o out
  ctrplan bound scenarios/robots/table_1_pair.toml --theta-deg 0 180 --l-mm 0 -17 -o out \
--sweep contact.1.clearance_mm=0.05:3:30 --sweep contact.1.friction_coefficient=0:0.5:26
"""


def add_parser(commands: Any) -> None:
    """Adds the command to the command line."""
    parser = commands.add_parser(
        "bound",
        help="bound the friction error at one configuration, or over a sweep",
        description="Largest tip deviation that friction can cause at one configuration, "
        "over all directions of approach; with --sweep, sweep.csv and sweep.png over one or two axes.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("robot", metavar="ROBOT.toml")
    add_joint_options(parser)
    parser.add_argument(
        "--sweep",
        action="append",
        default=[],
        metavar="KEY=FROM:TO:COUNT",
        help="axis of a sweep, at most two: theta_I (deg) or l_I (mm) of tube I, or a key as in --set",
    )
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for a sweep's files (default: {DEFAULT_FOLDER})")
    parser.add_argument(
        "--accuracy",
        choices=["search", "certificate", "exact"],
        help="mesh; exact: the certificate's with the exact geometry, for clearances above about 0.1 mm (default: "
        "certificate; search with --sweep)",
    )
    parser.add_argument(
        "--corners",
        choices=["all", "extreme"],
        help="friction states to visit: all 2^(n-1) corners of n <= 10 tubes, or those that a search finds to move "
        "the tip farthest (default: all up to 8 tubes)",
    )
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    add_set_option(parser, "the robot's key")
    parser.set_defaults(run=run_bound)


def run_bound(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError when there is no bound to print."""
    import numpy as np

    from ctrplan.files.robot_file import load_robot
    from ctrplan.mechanics.shapes import Status
    from ctrplan.pipeline.left_ranges import range_notes
    from ctrplan.planning.play import play_shift
    from ctrplan.robot.nesting import nesting_violation

    if arguments.sweep:
        from ctrplan.commands.sweep import run_sweep

        return run_sweep(arguments)
    if arguments.output is not None:
        raise InputError("goes with --sweep only", key="--output", value=arguments.output)
    robot = load_robot(arguments.robot, arguments.overrides)
    commanded = configuration(arguments, robot.n)
    theta_b, l_b = robot.collars(*commanded)
    if sentence := nesting_violation(robot, theta_b, l_b):
        raise InputError(sentence, key="--l-mm", value=arguments.l_mm, unit="mm")
    for warning in (*robot.warnings, *range_notes(robot, *commanded)):
        print(f"ctrplan: warning: {warning}", file=sys.stderr)
    found = _bounded(robot, theta_b, l_b, arguments)
    play_mm = play_shift(robot, theta_b, l_b) * 1e3
    if arguments.json:
        collars = {"theta_deg": np.degrees(theta_b).tolist(), "l_mm": (l_b * 1e3).tolist()}
        content = {**_bound_json(found, play_mm), "collars": collars}
        print(json.dumps(content, indent=1, allow_nan=False))
    else:
        print(_bound_text(found, play_mm))
        if robot.drive.terms:
            print(_collars_text(theta_b, l_b))
    if not math.isfinite(found.position_m):
        raise SolverError(_no_bound(found))
    if found.frictionless.status is Status.UNSTABLE:
        raise NoAnswerError("the configuration is elastically unstable: the robot snaps away, no bound is promised.")
    return 0


def _no_bound(found: Bound) -> str:
    """Why there is none, in one sentence."""
    from ctrplan.mechanics.shapes import Status

    statuses = [found.frictionless.status, *(shape.status for shape in found.corners)]
    if Status.OVERTWISTED in statuses:
        return (
            "friction at its full limit would wind a tube up, to a shear strain of more than 0.5 (nitinol bears about "
            "0.14), before the robot rests: no bound at this configuration; less friction or other joints may have one."
        )
    reached = sum(status < Status.FAILED for status in statuses[1:])
    rule = f"{reached} of {len(found.corners)} friction corners reached their residual: no bound is promised"
    return f"{rule} at this configuration."


def _bounded(robot: Robot, theta_b: Array, l_b: Array, arguments: argparse.Namespace) -> Bound:
    """The bound, with its time said before and a bar meanwhile where it takes long."""
    from ctrplan.commands.bound_time import sentence_beforehand
    from ctrplan.commands.progress_bar import ProgressBar

    accuracy: Accuracy = arguments.accuracy or "certificate"
    if said := sentence_beforehand(robot, theta_b, l_b, accuracy, arguments.corners):
        print(f"ctrplan: {said}", file=sys.stderr)
    with ProgressBar(quiet=not sys.stderr.isatty(), patience_s=2.0) as bar:
        return robot.bound(
            theta_b,
            l_b,
            accuracy=accuracy,
            corners=arguments.corners,
            progress=lambda share: bar.show("bound", share),
        )


def _corners(found: Bound) -> Iterator[tuple[tuple[int, ...], Shape]]:
    """Friction states, one sign for each of the n - 1 pairs of tubes, and their shapes."""
    signs = (tuple(row) for row in found.corner_phi.astype(int).tolist())
    return zip(signs, found.corners, strict=True)


def _bound_json(found: Bound, play_mm: float) -> dict[str, Any]:
    return {
        "bound_position_mm": _finite(found.position_m * 1e3),
        "bound_tangent_deg": _finite(math.degrees(found.tangent_rad)),
        "play_mm": _finite(play_mm),
        "frictionless": _shape_json(found.frictionless),
        "corners": [{"phi": list(phi), **_shape_json(shape)} for phi, shape in _corners(found)],
    }


def _shape_json(shape: Shape) -> dict[str, Any]:
    return {
        "tip_mm": [_finite(round(x * 1e3, 6)) for x in shape.tip_m.tolist()],
        "tip_tangent": [_finite(x) for x in shape.tip_tangent.tolist()],
        "status": shape.status.name,
        "residual": _finite(shape.residual),
        "stability": _finite(shape.stability),
        "max_strain": _finite(shape.max_strain),
    }


def _finite(value: float) -> float | None:
    """JSON has no other numbers: what a FAILED solve leaves may be none."""
    return value if math.isfinite(value) else None


def _bound_text(found: Bound, play_mm: float) -> str:
    free, position_mm, tangent_deg = found.frictionless, found.position_m * 1e3, math.degrees(found.tangent_rad)
    lines = [
        f"worst-case friction error of the tip: {position_mm:.3f} mm, {tangent_deg:.3f} deg",
        f"  frictionless    {_tip(free)}, stability {free.stability:.2f}",
    ]
    for phi, shape in _corners(found):
        signs = " ".join("+" if sign > 0 else "-" for sign in phi) or "none"
        apart_mm = math.dist(shape.tip_m, free.tip_m) * 1e3
        lines.append(f"  phi = {signs:9} {_tip(shape)}, {apart_mm:.3f} mm from the frictionless tip")
    if play_mm:
        lines.append(f"  play of the drive may move it by {play_mm:.3f} mm besides")
    if not math.isfinite(found.position_m):
        lines.append("  a solve did not reach its residual: no bound is promised here")
    return "\n".join(lines)


def _collars_text(theta_b: Array, l_b: Array) -> str:
    angles = ", ".join(f"{math.degrees(angle):.3f}" for angle in theta_b.tolist())
    places = ", ".join(f"{place * 1e3:.3f}" for place in l_b.tolist())
    return f"  effects of the drive put the collars at theta = ({angles}) deg, l = ({places}) mm"


def _tip(shape: Shape) -> str:
    x, y, z = shape.tip_m * 1e3
    return f"tip ({x:9.3f}, {y:9.3f}, {z:9.3f}) mm   {shape.status.name}"
