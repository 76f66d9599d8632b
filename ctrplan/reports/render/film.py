"""The pictures of a film: the robot at each pose, with the time and what friction makes of it at that moment."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ctrplan.reports import looks
from ctrplan.reports.plan_scene import WrittenMotion
from ctrplan.reports.render.bodies import moving_bodies, rgb, still_bodies
from ctrplan.reports.render.camera import Camera
from ctrplan.reports.render.compass import draw_compass
from ctrplan.reports.render.picture import Picture, Stage
from ctrplan.reports.render.views import View, camera_of
from ctrplan.reports.stated_error import stated_error_m
from ctrplan.reports.words import millimetres

SKY = np.stack([rgb("#FFFFFF"), rgb("#E4EAF0")])
DARK = np.stack([rgb("#14090A"), rgb("#14090A")])
SAMPLES = {True: 1, False: 2}  # rays a pixel each way, where the camera moves and where it stands
TEXT = 0.026  # height of letters, of the picture's
COMPASS = 3.0  # letters from the middle of the patient's sides to the picture's edge


def film(motion: WrittenMotion, view: View, width: int, height: int) -> Iterator[Picture]:
    """A picture (height, width, 3) for each pose."""
    inside = view == "inside"
    camera, still = camera_of(view, motion, width / height), still_bodies(motion, inside)
    captions, stage = _captions(motion), None
    for pose, caption in zip(motion.path, captions, strict=True):
        if stage is None or camera(pose) is not stage.camera:
            stage = Stage(still, camera(pose), width, height, SAMPLES[inside], DARK if inside else SKY)
        yield _labelled(stage.with_moving(moving_bodies(pose, motion, inside)), motion, caption, inside, stage.camera)


def _captions(motion: WrittenMotion) -> list[str]:
    bound, clearance, last = stated_error_m(motion), motion.at("clearance_m"), motion.times_s[-1]
    texts = []
    for time_s, bound_m, clearance_m in zip(motion.times_s, bound.tolist(), clearance.tolist(), strict=True):
        words = [f"{time_s:.1f} of {last:.1f} s"]
        if np.isfinite(bound_m):
            words.append(f"worst-case friction error {millimetres(bound_m)}")
        if np.isfinite(clearance_m):
            words.append(f"clearance {millimetres(clearance_m)}")
        texts.append("    ".join(words))
    return texts


def _labelled(picture: Picture, motion: WrittenMotion, caption: str, inside: bool, camera: Camera) -> Picture:
    image = Image.fromarray(picture)
    draw, size = ImageDraw.Draw(image), max(11, round(TEXT * image.height))
    ink = "#F3ECEA" if inside else looks.INK
    margin = round(0.8 * size)
    halo: dict[str, Any] = {"stroke_width": max(1, size // 9), "stroke_fill": "#1D0F0F" if inside else "#F4F7F9"}
    draw.text((margin, margin), motion.scenario.name, fill=ink, font=_font(size, bold=True), **halo)
    draw.text((margin, image.height - margin), caption, fill=ink, font=_font(size), anchor="ls", **halo)
    _bar(draw, image.size, caption, motion)
    _key(draw, image.width - margin, margin, size, motion, ink, inside, halo)
    corner = (image.width - margin - COMPASS * size, image.height - margin - COMPASS * size)
    frame = motion.scenario.frame
    draw_compass(draw, corner, (COMPASS - 0.5) * size, camera, frame, _font(round(0.85 * size)), ink, halo)
    return np.asarray(image)


def _bar(draw: ImageDraw.ImageDraw, shape: tuple[int, int], caption: str, motion: WrittenMotion) -> None:
    """How much of the time has passed, along the lower edge."""
    share = float(caption.split(" of ")[0]) / max(motion.times_s[-1], 1e-9)
    draw.rectangle((0, shape[1] - 4, share * shape[0], shape[1]), fill=looks.TIP_PATH.colour)


def _key(
    draw: ImageDraw.ImageDraw,
    right: int,
    top: int,
    size: int,
    motion: WrittenMotion,
    ink: str,
    inside: bool,
    halo: dict[str, Any],
) -> None:
    """Names and colours, in the upper right corner."""
    entries = [looks.TIP_PATH, looks.GOAL_LOOK]
    if not inside:
        tubes = [looks.tube_look(tube) for tube in range(motion.scenario.robot.n)]
        entries = [*tubes, looks.ENVELOPE_LOOK, *entries, *looks.anatomy_looks(motion.scenario)]
    font = _font(round(0.85 * size))
    for row, look in enumerate(entries):
        y = top + round(1.35 * size * row)
        draw.rectangle((right - 0.8 * size, y, right, y + 0.8 * size), fill=look.colour)
        draw.text((right - 1.2 * size, y + 0.4 * size), look.name, fill=ink, font=font, anchor="rm", **halo)


def write_caption(image: Image.Image, text: str) -> None:
    """Writes a line along the lower edge."""
    size = max(11, round(TEXT * image.height))
    place = (0.8 * size, image.height - 0.8 * size)
    halo: dict[str, Any] = {"stroke_width": max(1, size // 9), "stroke_fill": "#F4F7F9"}
    ImageDraw.Draw(image).text(place, text, fill=looks.INK, font=_font(size), anchor="ls", **halo)


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu, which comes with matplotlib."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / f"DejaVuSans{'-Bold' if bold else ''}.ttf"), size)
