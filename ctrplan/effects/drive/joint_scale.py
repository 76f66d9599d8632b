"""Gear ratios or pitches that are off."""

from __future__ import annotations

from collections.abc import Sequence

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import (
    Effect,
    Parameter,
    Values,
    clauses,
    joined_clauses,
    numbered,
    register,
    shifted,
    sliding,
    turning,
)
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

FAR = ("too far", "too little")


@register
class JointScale(Effect):
    """Relative errors s of the travel from zero: `theta_I` and `l_I` of tube I, without unit (0.01 is 1 % too far)."""

    name = "joint_scale"
    in_words = "wrong scale of a joint"
    stage = "drive"
    equation = "joint = commanded (1 + s)"
    signature = "errors grow with the distance of a joint from its zero, turn after turn"
    look_alikes = ("homing_offset", "varying_precurvature", "drift")
    experiment = "the same relative angle reached a full turn apart"

    def in_figures(self, values: Values, robot: Robot) -> str:
        turns = clauses(values, "theta_I", "tube {I} turns {value} % {sign}", signs=FAR, factor=100)
        return joined_clauses(turns, clauses(values, "l_I", "tube {I} slides {value} % {sign}", signs=FAR, factor=100))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        tubes = range(1, robot.n + 1)
        names = numbered("theta", tubes) + numbered("l", tubes)
        return tuple(Parameter(name, 0.03, lower=-0.5, upper=0.5) for name in names)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        return "" if turning(data) or sliding(data) else "no joint moves enough"

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        turns, slides = numbered("theta", turning(data)), numbered("l", sliding(data))
        return [names for names in (turns, slides, turns + slides if turns and slides else []) if names]

    def drive(self, values: Values, collars: Collars, directions: Array) -> Collars:
        return shifted(collars, values, lambda scale, column: scale * column)
