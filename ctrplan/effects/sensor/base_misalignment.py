"""A robot frame that is not where the tracker thinks it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.effects.effect import DEGREE, MILLIMETRE, Effect, Parameter, Values, length_of, register, two_digits
from ctrplan.measurement.measurements import Measurements, Poses, moved_rigidly
from ctrplan.robot.robot import Robot


@register
class BaseMisalignment(Effect):
    """One rigid motion of all poses: `rotation_x_deg` ... (a rotation vector), then `shift_x_mm` ..."""

    name = "base_misalignment"
    in_words = "misaligned base"
    stage = "sensor"
    equation = "p = R(rotation vector) p + t, tangents turn with R"
    signature = "all poses are displaced by one rigid motion"
    look_alikes = ("homing_offset", "sensor_offset", "gravity")
    experiment = "register the base again with points that do not belong to the robot"

    def in_figures(self, values: Values, robot: Robot) -> str:
        turned = length_of(values, "rotation_x_deg", "rotation_y_deg", "rotation_z_deg")
        moved = length_of(values, "shift_x_mm", "shift_y_mm", "shift_z_mm")
        return f"the base is turned by {two_digits(turned)} deg and shifted by {two_digits(moved)} mm"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        turns = (Parameter(f"rotation_{axis}_deg", 4.0, lower=-90, upper=90, si=DEGREE) for axis in "xyz")
        shifts = (Parameter(f"shift_{axis}_mm", 4.0, lower=-200, upper=200, si=MILLIMETRE) for axis in "xyz")
        return (*turns, *shifts)

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        names = [parameter.name for parameter in self.parameters(robot)]
        return [names[:3], names[3:], names]

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        turn = np.array([values.get(f"rotation_{axis}_deg", 0.0) for axis in "xyz"])
        shift = np.array([values.get(f"shift_{axis}_mm", 0.0) for axis in "xyz"])
        return moved_rigidly(poses, turn, shift)
