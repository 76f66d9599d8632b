"""The two frames in which programs state places in a patient, both in the patient's own directions.

RAS: x to the right, y to the front (anterior), z to the head (superior). LPS: x to the left, y to the back (posterior),
z to the head. Either becomes the other by turning x and y round. Nothing in a list of numbers tells which one it is in,
so each is said: by a file, or by whoever names the file.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from ctrplan.base.arrays import Array, read_only
from ctrplan.storage.toml_document import TomlTable

Frame = Literal["RAS", "LPS"]
FRAMES: tuple[Frame, ...] = get_args(Frame)
OTHER: dict[Frame, Frame] = {"RAS": "LPS", "LPS": "RAS"}
TURNED = read_only(np.array([-1.0, -1.0, 1.0]))
SAME = read_only(np.ones(3))
# What the ends of the axes point to, from minus to plus.
ENDS: dict[Frame, tuple[tuple[str, str], ...]] = {
    "RAS": (("L", "R"), ("P", "A"), ("I", "S")),
    "LPS": (("R", "L"), ("A", "P"), ("I", "S")),
}


def signs(frame: Frame, wanted: Frame) -> Array:
    """(3,) by which coordinates in `frame` are multiplied to be in frame `wanted`."""
    return SAME if frame == wanted else TURNED


def axis_label(axis: int, frame: Frame | None) -> str:
    """What a picture writes at an axis, 0 to 2: its name, and the letters of its ends where the frame is known."""
    if frame is None:
        return "xyz"[axis]
    minus, plus = ENDS[frame][axis]
    return f"{'xyz'[axis]}, {minus} \u2192 {plus}"


def scenario_frame(table: TomlTable) -> Frame | None:
    """The frame that the scenario file around a table says; None where it says none."""
    frame = table.document.content.get("frame")
    return frame if frame in FRAMES else None


def to_scenario(table: TomlTable, stated: Frame | None, given: Frame | None, *, is_patient: bool) -> Array:
    """(3,) signs that take coordinates of a file to the scenario's frame, in the patient's directions.

    stated: what the file says of its frame. given: key `frame` of the table. is_patient: whether the file is of no use
    without a frame, as an image; else a scenario in which nobody says a frame has one of its own.
    Raises InputError where it is not known, or two say different things.
    """
    own = scenario_frame(table)
    if stated and given and stated != given:
        raise table.fault(f"contradicts the file, which says {stated}", "frame")
    result = stated or given
    if own is None and (result or is_patient):
        states = f"{table.key()} is in {result}" if result else f"{table.key()} is an image of a patient"
        rule = f"is missing: {states}, so say whether base, goal and shapes are in RAS or in LPS"
        raise table.document.fault(rule, "frame")
    if own is None:
        return SAME
    if result is None:
        raise table.fault("is missing: the file does not say whether its coordinates are in RAS or in LPS", "frame")
    return signs(result, own)
