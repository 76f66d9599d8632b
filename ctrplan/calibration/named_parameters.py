"""Numbers of the robot that are fitted by their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ctrplan.effects.effect import Effect, Parameter, Values
from ctrplan.robot.named_numbers import value_of
from ctrplan.robot.robot import Robot

RELATIVE_PRIOR, LEAST_PRIOR = 0.2, 0.2  # of a named number whose size is known, and of one that is zero


class NamedParameters(Effect):
    """Numbers of the robot by their names, `parameters.py`, as a term of the mechanics."""

    name = "named"
    stage = "mechanics"
    of_the_file = True

    def __init__(self, names: Sequence[str], priors: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]):
        """priors: name -> standard deviation; bounds: name -> (lowest, highest); usual ones for names not in them."""
        self.names, self.priors, self.bounds = tuple(names), priors, bounds

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The named numbers, with the priors and bounds that were given for them."""
        return tuple(self._parameter(robot, name) for name in self.names)

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        """The robot's numbers are the parameters themselves."""
        return dict(values)

    def _parameter(self, robot: Robot, name: str) -> Parameter:
        value = value_of(robot, name)
        low, high = self.bounds.get(name, _usual_bounds(name))
        prior = self.priors.get(
            name, 0.15 if name.endswith("poisson_ratio") else RELATIVE_PRIOR * abs(value) or LEAST_PRIOR
        )
        return Parameter(name, prior, neutral=value, lower=low, upper=high)


def _usual_bounds(name: str) -> tuple[float, float]:
    key = name.rsplit(".", 1)[-1]
    if key == "poisson_ratio":
        return -0.95, 2.0
    if key in ("bending_stiffness_Nm2", "clearance_m", "length_m"):
        return 1e-9, float("inf")
    if key == "friction_coefficient":
        return 0.0, 2.0
    return -float("inf"), float("inf")
