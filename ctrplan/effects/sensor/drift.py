"""A tracker or a mounting that moves slowly in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import HOUR_S
from ctrplan.effects.effect import DEGREE, MILLIMETRE, Effect, Parameter, Values, length_of, register, two_digits
from ctrplan.measurement.measurements import Measurements, Poses, moved_rigidly
from ctrplan.robot.robot import Robot

MM_PER_H, DEG_PER_H = MILLIMETRE / HOUR_S, DEGREE / HOUR_S
MOST = 1e4  # mm or deg an hour: what jumps is no drift


@register
class Drift(Effect):
    """A rigid motion per hour of time_s: `shift_x_mm_per_h` ... and `rotation_x_deg_per_h` ... (rotation vector)."""

    name = "drift"
    in_words = "drift of the sensor"
    stage = "sensor"
    equation = "a rigid motion that grows in proportion to time_s, from none at the first waypoint"
    signature = "errors grow with the time of the experiment, whatever the joints"
    look_alikes = ("base_misalignment", "joint_scale")
    experiment = "repeat the first configurations at the end"
    needs_time = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        moved = length_of(values, "shift_x_mm_per_h", "shift_y_mm_per_h", "shift_z_mm_per_h")
        turned = length_of(values, "rotation_x_deg_per_h", "rotation_y_deg_per_h", "rotation_z_deg_per_h")
        return f"the sensor drifts by {two_digits(moved)} mm and {two_digits(turned)} deg an hour"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        shifts = (Parameter(f"shift_{axis}_mm_per_h", 100.0, lower=-MOST, upper=MOST, si=MM_PER_H) for axis in "xyz")
        turns = (
            Parameter(f"rotation_{axis}_deg_per_h", 100.0, lower=-MOST, upper=MOST, si=DEG_PER_H) for axis in "xyz"
        )
        return (*shifts, *turns)

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        names = [parameter.name for parameter in self.parameters(robot)]
        return [names[:3], names]

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        if data.time_s is None:
            return poses
        elapsed = (data.time_s[data.rows] - data.time_s[0])[:, None]
        shift = np.array([values.get(f"shift_{axis}_mm_per_h", 0.0) for axis in "xyz"])
        turn = np.array([values.get(f"rotation_{axis}_deg_per_h", 0.0) for axis in "xyz"])
        return moved_rigidly(poses, elapsed * turn, elapsed * shift)
