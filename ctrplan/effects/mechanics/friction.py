"""Coulomb friction between neighbouring tubes."""

from __future__ import annotations

from collections.abc import Mapping

from ctrplan.effects.effect import Effect, Parameter, Values, clauses, joined_clauses, numbered, register, two_digits
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


@register
class Friction(Effect):
    """Coulomb friction coefficients: `mu_I` between tubes I and I + 1; neutral is what the robot file has."""

    name = "friction"
    in_words = "friction between the tubes"
    stage = "mechanics"
    equation = "force lambda phi mu J d and torque phi mu r lambda |d|^2 / c at every contact, (38), (41)"
    signature = "poses of one configuration differ with the direction of approach, not after a decreasing oscillation"
    look_alikes = ("backlash", "lag", "shaft_torsion")
    experiment = "approach strongly opposed curvatures from both sides and after an oscillation, at rest"
    depends_on_history = True
    sets_outright = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        usual = {parameter.name: two_digits(parameter.neutral) for parameter in self.parameters(robot)}
        text = "the friction coefficient of tubes {I} and {next} is {value}, not "
        each = [clauses({name: value}, "mu_I", text + usual[name]) for name, value in values.items()]
        return joined_clauses(*each)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        neutral = robot.friction[:, 1].tolist()
        return tuple(
            Parameter(name, 0.3, neutral=mu, lower=0.0, upper=1.0, start=max(mu, 0.05))
            for name, mu in zip(numbered("mu", range(1, robot.n)), neutral, strict=True)
        )

    def untestable(self, robot: Robot, data: Measurements) -> str:
        from ctrplan.measurement.approach import friction_state

        if robot.n < 2:
            return "one tube rubs on nothing"
        if abs(friction_state(data)).max() < 0.2:
            return "no pose was approached by a rotation that loads friction"
        return ""

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        return {f"contact.{name[3:]}.friction_coefficient": value for name, value in values.items()}
