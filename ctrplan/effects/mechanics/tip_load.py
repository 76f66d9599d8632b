"""A constant force on the tip, such as a cable or a tool."""

from __future__ import annotations

from collections.abc import Mapping

from ctrplan.effects.effect import Effect, Parameter, Values, direction_of, length_of, register, two_digits
from ctrplan.robot.robot import Robot


@register
class TipLoad(Effect):
    """A dead load on the innermost tip: `force_x_N` ... [N] in the robot's frame."""

    name = "tip_load"
    in_words = "force on the tip"
    stage = "mechanics"
    equation = "constant force on the innermost tip, robot's frame"
    signature = "tips are shifted in one world direction, more when the robot is extended"
    look_alikes = ("gravity", "base_misalignment")
    experiment = "fully retracted against fully extended, in several directions of bending"
    scales_with_stiffness = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        names = ("force_x_N", "force_y_N", "force_z_N")
        size, along = two_digits(length_of(values, *names)), direction_of(values, *names)
        return f"a force of {size} N pulls at the tip along {along}"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"force_{axis}_N", 0.3, lower=-100.0, upper=100.0) for axis in "xyz")

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        return {f"loads.tip_force_N.{'xyz'.index(name[6]) + 1}": value for name, value in values.items()}
