"""A sensor that does not sit exactly at the tip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.effects.effect import DEGREE, MILLIMETRE, Effect, Parameter, Values, length_of, register, two_digits
from ctrplan.measurement.measurements import Measurements, Poses, rotation
from ctrplan.robot.robot import Robot


@register
class SensorOffset(Effect):
    """The sensor in the frame of the tip: moved by `offset_x_mm` ..., tilted by `tilt_x_deg`, `tilt_y_deg`."""

    name = "sensor_offset"
    in_words = "sensor beside the tip"
    stage = "sensor"
    equation = "p = p_tip + R_tip d, t = R_tip R(tilt) e_z, R_tip the frame of the innermost tube"
    signature = "a displacement that turns with the tip"
    look_alikes = ("base_misalignment", "homing_offset")
    experiment = "turn the innermost tube where nothing bends it: the offset draws a circle"
    turns_with_tip = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        moved = length_of(values, "offset_x_mm", "offset_y_mm", "offset_z_mm")
        turned = length_of(values, "tilt_x_deg", "tilt_y_deg")
        return f"the sensor sits {two_digits(moved)} mm off the tip and is tilted by {two_digits(turned)} deg"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        shifts = (Parameter(f"offset_{axis}_mm", 2.0, lower=-50, upper=50, si=MILLIMETRE) for axis in "xyz")
        tilts = (Parameter(f"tilt_{axis}_deg", 3.0, lower=-45, upper=45, si=DEGREE) for axis in "xy")
        return (*shifts, *tilts)

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        names = [parameter.name for parameter in self.parameters(robot)]
        return [names[:3], names] if data.has_tangents else [names[:3]]

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        offset = np.array([values.get(f"offset_{axis}_mm", 0.0) for axis in "xyz"])
        tilt = rotation(np.array([values.get("tilt_x_deg", 0.0), values.get("tilt_y_deg", 0.0), 0.0]))
        of_tip = (data.seen_marker == 0)[:, None]  # markers on the body have no such sensor
        return Poses(poses.position + of_tip * (poses.frame @ offset), poses.frame @ tilt)
