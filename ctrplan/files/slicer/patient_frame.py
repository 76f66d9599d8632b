"""Where the axes of the anatomy's frame point in the patient, and the frame that all files of Slicer are in.

RAS: x to the right, y to the front, z to the head. LPS, as DICOM has it: x to the left, y to the back, z to the head.
Slicer shows RAS and takes files for LPS unless they say otherwise; what is written here is in LPS and says so.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import InputError

Frame = Literal["RAS", "LPS"]
FRAMES: tuple[str, ...] = get_args(Frame)
SPACE = "LPS"  # of all files
HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # about the axis to the head: from one frame to the other, and back


def patient_frame(value: str | None, key: str = "--frame") -> Frame:
    """The frame of a name. Raises InputError where there is none, since a guess could turn the patient around."""
    for frame in get_args(Frame):
        if value == frame:
            return frame  # type: ignore[no-any-return]
    rule = "must be RAS or LPS: which axes the anatomy's frame has in the patient can't be guessed"
    raise InputError(rule, key=key, value=value)


def to_lps(frame: Frame) -> Array:
    """(3, 3) maps vectors of the anatomy's frame to LPS."""
    return np.eye(3) if frame == "LPS" else HALF_TURN


def lps_mm(points_m: Array, frame: Frame) -> Array:
    """Points (..., 3) [m] of the anatomy's frame in LPS [mm]."""
    turned: Array = points_m @ to_lps(frame) * MM_PER_M
    return turned + 0.0  # no minus zero
