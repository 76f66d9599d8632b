"""Torsional compliance between actuator and collar."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

from ctrplan.effects.effect import DEGREE, Effect, Parameter, Values, clauses, joined_clauses, register
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.tube import SHAFT_ROOM_M
from ctrplan.robot.robot import Robot

NEARLY_RIGID = 1e-3  # rad/(N m), which moves a tip by about a micrometre: a rigid shaft has no derivative


@register
class ShaftTorsion(Effect):
    """`compliance_I_rad_per_Nm` [rad/(N m)] of the shaft between the actuator and the collar of tube I."""

    name = "shaft_torsion"
    in_words = "twist of the shafts"
    stage = "mechanics"
    equation = "theta_collar = theta_commanded + C times the torque of the tube on its collar"
    signature = "tubes lag behind where curvatures oppose, all approaches alike without friction"
    look_alikes = ("clearance", "joint_scale", "nonlinear_elasticity")
    experiment = "relative angles near 90 deg, where the torque is largest, against 0 and 180 deg"
    scales_with_stiffness = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        text = "the shaft of tube {I} twists by {value} deg per N mm"
        return joined_clauses(clauses(values, "compliance_I_rad_per_Nm", text, factor=1e-3 / DEGREE))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"compliance_{i + 1}_rad_per_Nm", 3.0, lower=0.0, upper=1e3) for i in range(robot.n))

    def untestable(self, robot: Robot, data: Measurements) -> str:
        for i, (outer, inner) in enumerate(pairwise(robot.tubes), start=1):
            if inner.length_m - outer.length_m < SHAFT_ROOM_M:
                return f"tubes {i} and {i + 1} are equally long, which leaves no room between their bases for a shaft"
        return ""

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        return {
            f"tube.{n.split('_')[1]}.shaft_compliance_rad_per_Nm": value + NEARLY_RIGID for n, value in values.items()
        }
