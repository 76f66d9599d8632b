"""The rigid motions between robot and tracker, one for each set-up of the tracker: free wherever something remains.

A robot that is held in a hand, or registered anew, stands elsewhere in every run. Nothing else can be told before that.
So it is with the zeros of its joints where it was homed anew: they are free beside those of the first homing.
"""

from __future__ import annotations

from collections.abc import Sequence

from ctrplan.effects.effect import CATALOGUE
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

FRAME, SHIFT = "base_misalignment", "frame_shift"  # of the first set-up, and of the others beside it
HOMED = "homing_shift"  # zeros after every further homing
FRAMES = (FRAME, SHIFT, HOMED)
FRAME_MOVES = 0.9  # of the size of noise and smooth error, that a frame has to move positions by: a part of any smooth
# error is a frame; wrong ones had up to 0.8, true ones 0.97 and more


def frames(robot: Robot, data: Measurements) -> list[Term]:
    """One rigid motion, one more for every further frame that the poses are in, and zeros for every further homing."""
    effect = CATALOGUE[FRAME]
    found = [term(effect, [parameter.name for parameter in effect.parameters(robot)], robot)]
    for shift in (CATALOGUE[SHIFT], CATALOGUE[HOMED]):
        if not shift.untestable(robot, data) and not (data.of_collars and shift.stage == "drive"):
            (names,) = shift.variants(robot, data)
            found.append(term(shift, names, robot))
    return found


def frames_beside(robot: Robot, data: Measurements, terms: Sequence[Term]) -> list[Term]:
    """Those that are neither among the terms nor in the robot file."""
    known = {*robot.effects, *(t.name for t in terms)}
    return [t for t in frames(robot, data) if t.name not in known]
