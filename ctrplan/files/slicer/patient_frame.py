"""Where the axes of the anatomy's frame point in the patient, and the frame that all files of Slicer are in.

RAS: x to the right, y to the front, z to the head. LPS, as DICOM has it: x to the left, y to the back, z to the head.
Slicer shows RAS and takes files for LPS unless they say otherwise; what is written here is in LPS and says so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

Frame = Literal["RAS", "LPS"]
FRAMES: tuple[str, ...] = get_args(Frame)
SPACE = "LPS"  # of all files
HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # about the axis to the head: from one frame to the other, and back


def patient_frame(scenario: Scenario, given: str | None, key: str = "--frame") -> Frame:
    """The frame of a scenario's anatomy: the one that its file says, or else the one given.

    Raises InputError where nobody says one, since a guess could turn the patient around, and where two are said.
    """
    own: str | None = getattr(scenario, "frame", None)
    if own is not None and given is not None and own != given:
        raise InputError(f"contradicts the scenario, which says {own}", key=key, value=given)
    for frame in get_args(Frame):
        if (own or given) == frame:
            return frame  # type: ignore[no-any-return]
    rule = "must be RAS or LPS: which axes the anatomy's frame has in the patient can't be guessed"
    raise InputError(rule, key=key, value=given)


def to_lps(frame: Frame) -> Array:
    """(3, 3) maps vectors of the anatomy's frame to LPS."""
    return np.eye(3) if frame == "LPS" else HALF_TURN


def lps_mm(points_m: Array, frame: Frame) -> Array:
    """Points (..., 3) [m] of the anatomy's frame in LPS [mm]."""
    turned: Array = points_m @ to_lps(frame) * MM_PER_M
    return turned + 0.0  # no minus zero
