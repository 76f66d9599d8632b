"""An outermost tube that is not straight behind the front plate."""

from __future__ import annotations

import math

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import Effect, Parameter, Values, length_of, register, two_digits
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

LEAST_M = 2e-3


@register
class BentBase(Effect):
    """`curvature_x_per_m`, `curvature_y_per_m` k [1/m] of tube 1 between its collar and the plate, turning with it.

    A beam clamped in the collar and supported by the plate's bore, length L, leaves the plate at an angle of k L / 4.
    """

    name = "bent_base"
    in_words = "outermost tube bent behind the plate"
    stage = "mechanics"
    equation = "all in front of the plate turns by R(theta_1) k L / 4, L = -l_1"
    signature = "the robot tilts as a whole, the tilt turns with tube 1 and grows while it is drawn back"
    acts_at_rest = False
    look_alikes = ("base_misalignment", "off_plane_precurvature", "eccentricity")
    experiment = "turn all tubes together with tube 1 drawn back, then pushed home: the circle of the tip shrinks"

    def in_figures(self, values: Values, robot: Robot) -> str:
        bent = length_of(values, "curvature_x_per_m", "curvature_y_per_m")
        return f"tube 1 is bent behind the plate, with a curvature of {two_digits(bent)} 1/m"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"curvature_{axis}_per_m", 1.0, lower=-100.0, upper=100.0) for axis in "xy")

    def untestable(self, robot: Robot, data: Measurements) -> str:
        return "" if data.l_commanded[data.rows, 0].min() < -LEAST_M else "tube 1 is never drawn back behind the plate"

    def plate_turn(self, values: Values, robot: Robot, collars: Collars) -> Array | None:
        x, y = (values.get(f"curvature_{axis}_per_m", 0.0) for axis in "xy")
        cosine, sine = np.cos(collars.theta[:, 0]), np.sin(collars.theta[:, 0])
        lever = np.maximum(-collars.l[:, 0], 0.0) / 4
        return np.column_stack([lever * (cosine * x - sine * y), lever * (sine * x + cosine * y), 0 * lever])

    def largest_turn_rad(self, values: Values, robot: Robot) -> float:
        return math.hypot(*values.values()) * robot.tubes[0].length_m / 4
