"""A front plate whose bore leaves the outermost tube room to tilt."""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import DEGREE, Effect, Parameter, Values, register, two_digits
from ctrplan.effects.mechanics.plate_compliance import STRAIGHT, bears_on_plate
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.shapes import largest_plate_moment, plate_moment
from ctrplan.robot.robot import Robot

SOFT_SHARE = 0.05  # of the largest moment, at which the tilt is half of the room (weight and friction of the guide)


@register
class PlateClearance(Effect):
    """`tilt_deg`: the room to tilt either way, radial clearance of the guide over half its length."""

    name = "plate_clearance"
    in_words = "play in the front plate"
    stage = "mechanics"
    equation = "all in front of the plate turns by tilt M / (|M| + M_0), M as of plate_compliance, M_0 5 % of its most"
    signature = "the robot tilts as a whole by one amount, towards where a section bends that is drawn back"
    acts_at_rest = False
    look_alikes = ("base_misalignment", "plate_compliance", "backlash")
    experiment = "push the outermost tube at the plate by hand: what moves without force is clearance"

    def in_figures(self, values: Values, robot: Robot) -> str:
        return f"the front plate lets the robot tilt by {two_digits(values['tilt_deg'])} deg either way"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (Parameter("tilt_deg", 0.5, lower=0.0, upper=20.0, si=DEGREE),)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        return "" if bears_on_plate(robot, data) else STRAIGHT

    def plate_turn(self, values: Values, robot: Robot, collars: Collars) -> Array | None:
        moment = plate_moment(robot.tubes, collars.theta, collars.l)
        soft = max(SOFT_SHARE * largest_plate_moment(robot.tubes), 1e-15)
        size = np.linalg.norm(moment, axis=1, keepdims=True)
        return np.column_stack([values.get("tilt_deg", 0.0) * moment / (size + soft), np.zeros(len(moment))])

    def largest_turn_rad(self, values: Values, robot: Robot) -> float:
        return values.get("tilt_deg", 0.0)
