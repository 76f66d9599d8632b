"""Rotary encoders or gears that run out of true."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import (
    DEGREE,
    Effect,
    Parameter,
    Values,
    joined_clauses,
    register,
    turning,
    vectors,
    with_column,
)
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


@register
class Eccentricity(Effect):
    """The once-per-turn error of tube I's rotation: `sin_I_deg` and `cos_I_deg` are a cos p and a sin p."""

    name = "eccentricity"
    in_words = "eccentric gears"
    stage = "drive"
    equation = "theta = commanded + a sin(commanded + p); sin, cos: a cos p, a sin p"
    signature = "errors repeat with every turn of one actuator, whatever the relative angles"
    look_alikes = ("off_plane_precurvature", "ovality")
    experiment = "turn all tubes together by a full turn: only an eccentricity shows"

    def in_figures(self, values: Values, robot: Robot) -> str:
        text = "the rotation of tube {I} errs by up to {value} deg once a turn"
        return joined_clauses(vectors(values, ("sin_I_deg", "cos_I_deg"), text))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{part}_{i + 1}_deg", 4.0, lower=-45.0, upper=45.0, si=DEGREE)
            for i in range(robot.n)
            for part in ("sin", "cos")
        )

    def untestable(self, robot: Robot, data: Measurements) -> str:
        return "" if turning(data) else "no tube turns"

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        each = [[f"sin_{i}_deg", f"cos_{i}_deg"] for i in turning(data)]
        return [*each, sum(each, [])] if len(each) > 1 else each

    def drive(self, values: Values, collars: Collars, directions: Array) -> Collars:
        theta = collars.theta
        for name, amplitude in values.items():
            wave, tube = (np.sin, np.cos)[name.startswith("cos")], int(name.split("_")[1])
            theta = with_column(theta, tube, amplitude * wave(collars.theta[:, tube - 1]))
        return Collars(theta, collars.l)
