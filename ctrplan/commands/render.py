"""`ctrplan render`: a written plan as a film, without a browser or a screen."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ctrplan.base.arguments import Number, in_plain_digits
from ctrplan.commands.options import add_number, add_plan_arguments, read_plan, refuse_alone, solved_motion
from ctrplan.commands.terminal import PATIENCE_S, ProgressBar, tell_next, typed
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.reports.render.rasteriser import Picture

CAMERAS = ("side", "plate", "target", "inside")
FPS = Number(1, 60, "pictures a second")
SIZES = (64, 4096)  # pixels a side
PICTURES_PER_S = 12  # as few as still look like a motion: files of a GIF grow with them
MOST_PICTURES = 600  # of longer motions fewer, which play faster
DESCRIPTION = (
    "Solve a written plan's robot at each picture of a film and draw it with its anatomy, off screen; "
    "write an MP4 (which needs ffmpeg, or pip install ctrplan[video]), a GIF, or the goal as PNG."
)
EXAMPLES = """cameras:
  side      all of the robot, from where it spreads widest
  plate     from behind the front plate, over the shoulder of whoever stands at the drive
  target    the goal from near by
  inside    from the tip, where it points: what an endoscope would see

examples:
  ctrplan render out/plan.json -o motion.gif
  ctrplan render out/plan.json -o inside.mp4 --camera inside --fps 24 --size 1280x720
  ctrplan render out/plan.json -o goal.png --camera target
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    add_plan_arguments(parser)
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="a .mp4, .gif or .png")
    parser.add_argument("--camera", choices=CAMERAS, default="side", help="from where (default: %(default)s)")
    add_number(parser, "--fps", FPS, help=f"pictures a second (default: {PICTURES_PER_S})")
    parser.add_argument("--size", default="960x720", metavar="WxH", help="in pixels (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises InputError for what is no plan, and for other kinds of files."""
    from ctrplan.reports.render.film import film, film_suffix, write_film

    suffix, (width, height) = film_suffix(arguments.output), _size(arguments.size)
    if suffix == ".png":
        refuse_alone({"--fps": arguments.fps}, "a film")
    arguments.fps = arguments.fps or PICTURES_PER_S
    plan = read_plan(arguments)
    seconds = float(plan.time_s[-1])
    count = 2 if suffix == ".png" else min(max(2, round(seconds * arguments.fps) + 1), MOST_PICTURES)
    with ProgressBar(quiet=arguments.quiet, patience_s=PATIENCE_S) as bar:
        motion = solved_motion(plan, count, bar)
        pictures = film(motion, arguments.camera, width, height)
        shown = _watched(pictures, bar, len(motion.path))
        write_film(arguments.output, shown, arguments.fps)
    print(_summary(arguments, plan.scenario.name, suffix, len(motion.path), seconds))
    tell_next(f"open {typed(arguments.output)}; --camera shows it from elsewhere: {', '.join(CAMERAS)}")
    return 0


def _size(text: str) -> tuple[int, int]:
    """Width and height. Raises InputError."""
    values = [in_plain_digits(part, True) for part in text.lower().split("x")]
    low, high = SIZES
    if len(values) != 2 or not all(value is not None and low <= value <= high for value in values):
        raise InputError(f"must be such as 960x720, each from {low} to {high} pixels", key="--size", value=text)
    return int(values[0] or 0), int(values[1] or 0)


def _watched(pictures: Iterator[Picture], bar: ProgressBar, count: int) -> Iterator[Picture]:
    for k, picture in enumerate(pictures):
        bar.show("drawing", k / count)
        yield picture


def _summary(arguments: argparse.Namespace, name: str, suffix: str, count: int, seconds: float) -> str:
    if suffix == ".png":
        return f"{name}: {arguments.output}, seen from {arguments.camera}"
    faster = seconds * arguments.fps / max(count - 1, 1)
    pace = f", {faster:.1f} times faster than the robot" if faster > 1.05 else ""
    return f"{name}: {arguments.output}, {count} pictures of {seconds:.1f} s{pace}, seen from {arguments.camera}"
