"""The frame that all files of Slicer are in, and that of the anatomy which they are made from.

Slicer shows RAS and takes files for LPS unless they say otherwise; what is written here is in LPS and says so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ctrplan.anatomy.patient_frame import FRAMES, Frame, signs
from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario

SPACE: Frame = "LPS"  # of all files


SCENE = "scene.mrml"  # of a case folder: what 3D Slicer is to open


def patient_frame(scenario: Scenario, given: str | None, key: str = "--frame") -> Frame:
    """The frame of a scenario's anatomy: the one that its file says, or else the one given.

    Raises InputError where nobody says one, since a guess could turn the patient around, and where two are said.
    """
    own = scenario.frame
    if own is not None and given is not None and own != given:
        raise InputError(f"contradicts the scenario, which says {own}", key=key, value=given)
    for frame in FRAMES:
        if (own or given) == frame:
            return frame
    rule = "must be RAS or LPS: which axes the anatomy's frame has in the patient can't be guessed"
    raise InputError(rule, key=key, value=... if given is None else given)


def to_lps(frame: Frame) -> Array:
    """(3, 3) maps vectors of the anatomy's frame to LPS."""
    return np.diag(signs(frame, SPACE))


def lps_mm(points_m: Array, frame: Frame) -> Array:
    """Points (..., 3) [m] of the anatomy's frame in LPS [mm]."""
    turned: Array = points_m * signs(frame, SPACE) * MM_PER_M
    return turned + 0.0  # no minus zero
