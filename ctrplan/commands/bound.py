"""`ctrplan bound`: the friction bound at one configuration or over one or two axes, as text, JSON, table and
picture.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ctrplan.commands.options import add_joint_options, add_set_option, configuration
from ctrplan.commands.terminal import PATIENCE_S, ProgressBar, finite, tell_next, telling, typed, warn
from ctrplan.errors import InputError, NoAnswerError, SolverError
from ctrplan.storage.output_folder import DEFAULT, output_folder, write_results

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.mechanics.shapes import Accuracy, Bound, Shape
    from ctrplan.robot.robot import Robot
    from ctrplan.studies.sweep import Sweep

TURNS = ": are whole parts of a turn in radians: are these in radians?"
LONG_S = 2.0
FEWEST_TUBES = 6  # that may take so long
AT_ONCE = 4  # friction states that the core solves side by side
EXTREME_SHARE = 0.55  # of the states that a search for extreme corners may ask for, those that it does: 6 to 10 tubes
HARD_S = 10  # what the core grants corners that are hard to reach


def states_visited(n: int, corners: Literal["all", "extreme"]) -> float:
    """Friction states that a bound of n tubes solves; for extreme corners in the mean."""
    pairs = n - 1
    if corners == "all":
        return float(2**pairs)
    # each sign of each pair, two dozen candidates and their neighbours in four rounds, the corners chosen
    return EXTREME_SHARE * (2 * pairs + 1 + 24 + 8 * pairs + 16)


def sentence_beforehand(
    robot: Robot, theta_b: Array, l_b: Array, accuracy: Accuracy, corners: Literal["all", "extreme"] | None
) -> str | None:
    """What will be visited and how long that takes, by the least of three solves at the configuration.

    None where it is soon done.
    """
    from ctrplan.mechanics.core import MOST_TUBES_OF_ALL_CORNERS

    if robot.n < FEWEST_TUBES:
        return None
    chosen = corners or ("all" if robot.n <= MOST_TUBES_OF_ALL_CORNERS else "extreme")
    took = list[float]()
    for _ in range(3):  # the first makes room in memory, any may be held up by what else runs
        began = time.perf_counter()
        robot.solve(theta_b, l_b, accuracy=accuracy)
        took.append(time.perf_counter() - began)
    expected_s = min(took) * states_visited(robot.n, chosen) / AT_ONCE
    which = f"{2 ** (robot.n - 1)} corners of {robot.n} tubes"
    if chosen == "extreme":
        which = f"the extreme ones of {which}" + ("" if corners else ", all with --corners all")
    if expected_s < LONG_S:
        return None if corners or chosen == "all" else which
    return f"{which}: about {expected_s:.0f} s, up to {HARD_S} s more where corners are hard to reach"


OUTPUTS = ("sweep.csv", "sweep.png")


def run_sweep(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code, 1 if no point has a bound. Raises CtrplanError."""
    from ctrplan.files.robot_file import robot_from_dict
    from ctrplan.storage.toml_document import read_document
    from ctrplan.studies.sweep import check_axes, parse_axis, sweep

    if arguments.json:
        raise InputError("goes with one configuration; a sweep writes sweep.csv", key="--json")
    document = read_document(arguments.robot, arguments.overrides)
    robot = robot_from_dict(document.content, file=document.file)
    commanded = configuration(arguments, robot.n)
    axes = [parse_axis(text, robot.n) for text in arguments.sweep]
    check_axes(axes)
    accuracy: Accuracy = arguments.accuracy or "search"
    folder = output_folder(DEFAULT if arguments.output is None else arguments.output, OUTPUTS)
    with ProgressBar(patience_s=PATIENCE_S) as bar:
        result = sweep(document.content, axes, *commanded, file=document.file, accuracy=accuracy, progress=bar.show)
    _warn(result)
    _write(folder, result)
    print(_summary(folder, result))
    return 0 if result.usable.any() else 1


def _warn(result: Sweep) -> None:
    """Every warning about the robot as it is, and how many more the axes' values bring up."""
    own = result.robot.warnings
    new = [warning for warning in result.warnings if warning not in own]
    more = [f"{len(new) - 1} more like the last at other values of the sweep."] if len(new) > 1 else []
    warn([*own, *new[:1], *more])


def _write(folder: Path, result: Sweep) -> None:
    from ctrplan.reports.path_pictures import sweep_png
    from ctrplan.studies.sweep import sweep_csv

    write_results(folder, dict(zip(OUTPUTS, (sweep_csv(result), sweep_png(result)), strict=True)))


def _summary(folder: Path, result: Sweep) -> str:
    from ctrplan.mechanics.shapes import Status

    count = " x ".join(map(str, result.shape))
    lines = [f"{result.robot.name}: {count} points over {' and '.join(axis.key for axis in result.axes)}"]
    lines += [f"  {label:27} {text}" for label, text in _extremes(result).items()]
    counter = Counter(Status(status).name for status in result.bounds.status.tolist())
    lines.append(f"  {'status':27} {', '.join(f'{number} {name}' for name, number in counter.most_common())}")
    lines.append(f"  {'written to':27} {folder}/sweep.csv, sweep.png")
    return "\n".join(lines)


def _extremes(result: Sweep) -> dict[str, str]:
    import numpy as np

    if not result.usable.any():
        return {"worst-case friction error": "no bound is promised at any point"}
    bound_mm = np.where(result.usable, result.bounds.position_m * 1e3, np.nan)
    texts = {}
    for label, k in (("smallest friction error", np.nanargmin(bound_mm)), ("largest", np.nanargmax(bound_mm))):
        where = zip(result.axes, result.values[k].tolist(), strict=True)
        texts[label] = f"{bound_mm[k]:.3f} mm at {', '.join(axis.at(value) for axis, value in where)}"
    return texts


DESCRIPTION = (
    "Largest tip deviation that friction can cause at one configuration, "
    "over all directions of approach; with --sweep, sweep.csv and sweep.png over one or two axes."
)
EXAMPLES = """examples:
  ctrplan bound scenarios/robots/three_tube.toml --theta-deg 0 90 180 --l-mm 0 -17 -62.8
  ctrplan bound scenarios/robots/table_1_pair.toml --theta-deg 0 180 --l-mm 0 -17 \
--set contact.1.friction_coefficient=0.4
  ctrplan bound scenarios/robots/three_tube.toml --theta-deg 0 90 0 --l-mm 0 -17 -62.8 --sweep theta_3=0:360:121 -o out
  ctrplan bound scenarios/robots/table_1_pair.toml --theta-deg 0 180 --l-mm 0 -17 -o out \
--sweep contact.1.clearance_mm=0.05:3:30 --sweep contact.1.friction_coefficient=0:0.5:26
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("robot", metavar="ROBOT.toml")
    add_joint_options(parser)
    parser.add_argument(
        "--sweep",
        action="append",
        default=[],
        metavar="KEY=FROM:TO:COUNT",
        help="axis of a sweep, at most two: theta_I (deg) or l_I (mm) of tube I, or a key as in --set",
    )
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for a sweep's files (default: {DEFAULT})")
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


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError when there is no bound to print."""
    import numpy as np

    from ctrplan.base.arrays import in_radians
    from ctrplan.files.robot_file import load_robot
    from ctrplan.mechanics.shapes import Status
    from ctrplan.motion.play import play_shift
    from ctrplan.pipeline.chain import range_notes
    from ctrplan.robot.magnitudes import in_words, likely_units, reach_m
    from ctrplan.robot.robot import nesting_violation

    if arguments.sweep:
        return run_sweep(arguments)
    if arguments.output is not None:
        raise InputError("goes with --sweep only", key="--output", value=arguments.output)
    robot = load_robot(arguments.robot, arguments.overrides)
    commanded = configuration(arguments, robot.n)
    theta_b, l_b = robot.collars(*commanded)
    if sentence := nesting_violation(robot, theta_b, l_b):
        units = likely_units(float(np.abs(l_b).max()), "mm", 0.05 * reach_m(robot), reach_m(robot))
        sentence += f": are these in {in_words(units[:1])}?" if units else ""
        raise InputError(sentence, key="--l-mm", value=arguments.l_mm, unit="mm")
    turns = [] if in_radians(arguments.theta_deg) is None else [f"--theta-deg{TURNS}"]
    warn([*robot.warnings, *range_notes(robot, *commanded), *turns])
    result = _bounded(robot, theta_b, l_b, arguments)
    play_mm = play_shift(robot, *commanded) * 1e3
    if arguments.json:
        collars = {"theta_deg": np.degrees(theta_b).tolist(), "l_mm": (l_b * 1e3).tolist()}
        content = {**_bound_json(result, play_mm), "collars": collars}
        print(json.dumps(content, indent=1, allow_nan=False))
    else:
        print(_bound_text(result, play_mm))
        with telling("looking for other shapes of the robot at these joints"):
            others = _others(robot, theta_b, l_b, result)
        for line in others:
            print(line)
        if robot.drive.terms:
            print(_collars_text(theta_b, l_b))
    if not math.isfinite(result.position_m):
        raise SolverError(_no_bound(result))
    if result.frictionless.status is Status.UNSTABLE:
        raise NoAnswerError("the configuration is elastically unstable: the robot snaps away, no bound is promised.")
    if not arguments.json:
        tell_next(
            f"ctrplan view {typed(arguments.robot)}, a slider for every joint; ctrplan ik, to bring the tip to a point"
        )
    return 0


def _no_bound(bound: Bound) -> str:
    """Why there is none, in one sentence."""
    from ctrplan.mechanics.shapes import Status

    statuses = [bound.frictionless.status, *(shape.status for shape in bound.corners)]
    if Status.OVERTWISTED in statuses:
        return (
            "friction at its full limit would wind a tube up, to a shear strain of more than 0.5 (nitinol bears about "
            "0.14), before the robot rests: no bound at this configuration; less friction or other joints may have one."
        )
    reached = sum(status < Status.FAILED for status in statuses[1:])
    rule = f"{reached} of {len(bound.corners)} friction corners reached their residual: no bound is promised"
    return f"{rule} at this configuration."


def _bounded(robot: Robot, theta_b: Array, l_b: Array, arguments: argparse.Namespace) -> Bound:
    """The bound, with its time said before and a bar meanwhile where it takes long."""

    accuracy: Accuracy = arguments.accuracy or "certificate"
    if notice := sentence_beforehand(robot, theta_b, l_b, accuracy, arguments.corners):
        print(f"ctrplan: {notice}", file=sys.stderr)
    with ProgressBar(patience_s=2.0) as bar:
        return robot.bound(
            theta_b,
            l_b,
            accuracy=accuracy,
            corners=arguments.corners,
            progress=lambda share: bar.show("bound", share),
        )


def _corners(bound: Bound) -> Iterator[tuple[tuple[int, ...], Shape]]:
    """Friction states, one sign for each of the n - 1 pairs of tubes, and their shapes."""
    signs = (tuple(row) for row in bound.corner_phi.astype(int).tolist())
    return zip(signs, bound.corners, strict=True)


def _bound_json(bound: Bound, play_mm: float) -> dict[str, Any]:
    return {
        "bound_position_mm": finite(bound.position_m * 1e3),
        "bound_tangent_deg": finite(math.degrees(bound.tangent_rad)),
        "play_mm": finite(play_mm),
        "frictionless": _shape_json(bound.frictionless),
        "corners": [{"phi": list(phi), **_shape_json(shape)} for phi, shape in _corners(bound)],
    }


def _shape_json(shape: Shape) -> dict[str, Any]:
    return {
        "tip_mm": [finite(round(x * 1e3, 6)) for x in shape.tip_m.tolist()],
        "tip_tangent": [finite(x) for x in shape.tip_tangent.tolist()],
        "status": shape.status.name,
        "residual": finite(shape.residual),
        "stability": finite(shape.stability),
        "max_strain": finite(shape.max_strain),
    }


def _bound_text(bound: Bound, play_mm: float) -> str:
    free, position_mm, tangent_deg = bound.frictionless, bound.position_m * 1e3, math.degrees(bound.tangent_rad)
    lines = [
        f"worst-case friction error of the tip: {position_mm:.3f} mm, {tangent_deg:.3f} deg",
        f"  frictionless    {_tip(free)}, stability {free.stability:.2f}",
    ]
    for phi, shape in _corners(bound):
        signs = " ".join("+" if sign > 0 else "\u2212" for sign in phi) or "none"
        apart_mm = math.dist(shape.tip_m, free.tip_m) * 1e3
        lines.append(f"  corner {signs:8} {_tip(shape)}, {apart_mm:.3f} mm from the frictionless tip")
    if play_mm:
        lines.append(f"  play of the drive may move it by {play_mm:.3f} mm besides")
    if not math.isfinite(bound.position_m):
        lines.append("  a solve did not reach its residual: no bound is promised here")
    return "\n".join(lines)


def _others(robot: Robot, theta_b: Array, l_b: Array, bound: Bound) -> list[str]:
    """A line for each other branch; none for robots of which they are not enumerated."""
    from ctrplan.mechanics.equilibria import other_shapes

    return [
        f"  another {shape.headline()}, {distance * 1e3:.1f} mm from the frictionless tip: turns may lead there"
        for distance, shape in other_shapes(robot, theta_b, l_b, bound.frictionless.tip_m)
    ]


def _collars_text(theta_b: Array, l_b: Array) -> str:
    angles = ", ".join(f"{math.degrees(angle):.3f}" for angle in theta_b.tolist())
    places = ", ".join(f"{place * 1e3:.3f}" for place in l_b.tolist())
    return f"  effects of the drive put the collars at theta = ({angles}) deg, l = ({places}) mm"


def _tip(shape: Shape) -> str:
    x, y, z = shape.tip_m * 1e3
    return f"tip ({x:9.3f}, {y:9.3f}, {z:9.3f}) mm   {shape.status.name}"
