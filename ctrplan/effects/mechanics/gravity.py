"""The tubes' own weight."""

from __future__ import annotations

from collections.abc import Mapping

from ctrplan.effects.effect import Effect, Parameter, Values, direction_of, length_of, register, two_digits
from ctrplan.robot.robot import Robot

NITINOL_KG_M3 = 6450.0  # where the robot file gives no density; a lining or a tool makes g come out larger


@register
class Gravity(Effect):
    """The acceleration `g_x_m_s2` ... in the robot's frame, on every tube by its density."""

    name = "gravity"
    in_words = "weight of the robot"
    stage = "mechanics"
    equation = "density times cross section times g along every tube, robot's frame"
    signature = "tips sink in one world direction, most when everything is extended sideways"
    look_alikes = ("tip_load", "base_misalignment")
    experiment = "the robot mounted upright and on its side"
    scales_with_stiffness = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        names = ("g_x_m_s2", "g_y_m_s2", "g_z_m_s2")
        size, along = two_digits(length_of(values, *names)), direction_of(values, *names)
        return f"the tubes' weight bends them, {size} m/s2 along {along}"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"g_{axis}_m_s2", 40.0, lower=-1e3, upper=1e3) for axis in "xyz")

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        weights = {
            f"tube.{i + 1}.density_kg_m3": NITINOL_KG_M3
            for i, tube in enumerate(robot.tubes)
            if tube.density_kg_m3 == 0
        }
        return weights | {f"loads.gravity_m_s2.{'xyz'.index(name[2]) + 1}": value for name, value in values.items()}
