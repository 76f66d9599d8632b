"""Zero positions of the drive that are off."""

from __future__ import annotations

from collections.abc import Sequence

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import (
    DEGREE,
    MILLIMETRE,
    Effect,
    Parameter,
    Values,
    clauses,
    joined_clauses,
    numbered,
    register,
    shifted,
    sliding,
)
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


@register
class HomingOffset(Effect):
    """Constants added to base rotation and base translation of tube I: `theta_I_deg`, `l_I_mm`."""

    name = "homing_offset"
    in_words = "wrong zero of a joint"
    stage = "drive"
    equation = "joint = commanded + offset, rotations and translations"
    signature = "the robot stands as if a tube were turned or moved along by a constant amount"
    look_alikes = ("off_plane_precurvature", "base_misalignment", "joint_scale")
    experiment = "home again and repeat: an offset of homing changes, one of the tube does not"

    def in_figures(self, values: Values, robot: Robot) -> str:
        turned = clauses(values, "theta_I_deg", "tube {I} stands turned by {value} deg")
        moved = clauses(values, "l_I_mm", "tube {I} stands {value} mm {sign}", signs=("too far ahead", "too far back"))
        return joined_clauses(turned, moved)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        tubes = range(1, robot.n + 1)
        turns = (Parameter(name, 8.0, lower=-90.0, upper=90.0, si=DEGREE) for name in numbered("theta", tubes, "_deg"))
        slides = (Parameter(name, 2.0, lower=-20.0, upper=20.0, si=MILLIMETRE) for name in numbered("l", tubes, "_mm"))
        return (*turns, *slides)

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        turns = numbered("theta", range(1, robot.n + 1), "_deg")
        slides = numbered("l", sliding(data), "_mm")  # a tube that never slides may as well be longer or shorter
        return [turns, slides, turns + slides] if slides else [turns]

    def drive(self, values: Values, collars: Collars, directions: Array) -> Collars:
        return shifted(collars, values, lambda offset, _column: offset)
