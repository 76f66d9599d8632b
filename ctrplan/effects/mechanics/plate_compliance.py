"""A front collar and plate that yield in bending."""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import DEGREE, Effect, Parameter, Values, register, two_digits
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.shapes import largest_plate_moment, plate_moment
from ctrplan.robot.robot import Robot

STRAIGHT = "no curved section is ever drawn back into the front plate"
LEAST_SHARE = 0.05  # of the largest moment, by which that on the plate has to change


@register
class PlateCompliance(Effect):
    """`compliance_rad_per_Nm` C [rad/(N m)] of the front collar and plate together, alike in both directions."""

    name = "plate_compliance"
    in_words = "front collar that yields in bending"
    stage = "mechanics"
    equation = "all in front of the plate turns by C sum EI R(theta) u_hat of the curved sections inside the guide"
    signature = "the robot tilts as a whole while curved sections are drawn back, towards where they bend"
    acts_at_rest = False
    look_alikes = ("base_misalignment", "plate_clearance", "homing_offset")
    experiment = "draw a curved section into the plate and turn all tubes together: the tilt turns along"
    scales_with_stiffness = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        yields = two_digits(values["compliance_rad_per_Nm"] * 1e-3 / DEGREE)
        return f"front collar and plate yield by {yields} deg per N mm of bending"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (Parameter("compliance_rad_per_Nm", 0.1, lower=0.0, upper=100.0),)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        return "" if bears_on_plate(robot, data) else STRAIGHT

    def plate_turn(self, values: Values, robot: Robot, collars: Collars) -> Array | None:
        moment = plate_moment(robot.tubes, collars.theta, collars.l)
        return np.column_stack([values.get("compliance_rad_per_Nm", 0.0) * moment, np.zeros(len(moment))])

    def largest_turn_rad(self, values: Values, robot: Robot) -> float:
        return values.get("compliance_rad_per_Nm", 0.0) * largest_plate_moment(robot.tubes)


def bears_on_plate(robot: Robot, data: Measurements) -> bool:
    """Whether the moment on the plate differs from pose to pose."""
    moment = plate_moment(robot.tubes, data.theta_commanded[data.rows], data.l_commanded[data.rows])
    return bool(np.ptp(moment, axis=0).max() > LEAST_SHARE * largest_plate_moment(robot.tubes))
