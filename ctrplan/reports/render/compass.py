"""Letters for the patient's sides in a film: which way right, left, front, back, head and feet are for its camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import ImageDraw, ImageFont

from ctrplan.anatomy.patient_frame import ENDS, Frame
from ctrplan.reports.render.camera import Camera

LEAST = 0.25  # of its length that an axis has to show for its letters to be told apart
AXES = (("", "x"), ("", "y"), ("", "z"))  # of an anatomy whose frame nobody says


def letters(camera: Camera, frame: Frame | None) -> dict[str, tuple[float, float]]:
    """Where each letter stands around a middle: to the right and up, at most 1 away.

    Letters of axes that point to the eye or away from it are left out. Without a frame they are those of x, y and z.
    """
    ends = AXES if frame is None else ENDS[frame]
    found = dict[str, tuple[float, float]]()
    for axis, (minus, plus) in enumerate(ends):
        right, up = float(camera.axes[0, axis]), float(camera.axes[1, axis])
        if np.hypot(right, up) >= LEAST:
            found |= {plus: (right, up)} | ({minus: (-right, -up)} if minus else {})
    return found


def draw_compass(
    draw: ImageDraw.ImageDraw,
    middle: tuple[float, float],
    radius: float,
    camera: Camera,
    frame: Frame | None,
    font: ImageFont.FreeTypeFont,
    ink: str,
    halo: dict[str, Any],
) -> None:
    """Draws axes and letters around a pixel, letters `radius` pixels away where axes lie in the picture."""
    for letter, (right, up) in letters(camera, frame).items():
        place = (middle[0] + radius * right, middle[1] - radius * up)
        inner = (middle[0] + 0.7 * radius * right, middle[1] - 0.7 * radius * up)
        draw.line((*middle, *inner), fill=ink, width=max(1, round(radius / 24)))
        draw.text(place, letter, fill=ink, font=font, anchor="mm", **halo)
