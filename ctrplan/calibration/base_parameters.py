"""What ordinary calibration adjusts: precurvature magnitudes, stiffness ratios, Poisson's ratios.

Gauges: without loads the shape depends on ratios of stiffness only, so that the stiffness of tube 1 keeps its prior.
"""

from __future__ import annotations

from collections.abc import Mapping

from ctrplan.effects.effect import Effect, Parameter, Values
from ctrplan.robot.robot import Robot

CURVATURE_PRIOR, STIFFNESS_PRIOR, POISSON_PRIOR, FRICTION_PRIOR = 0.1, 0.2, 0.15, 0.1

ABSOLUTE_STIFFNESS = "stiffness_factor_1"


class BaseParameters(Effect):
    """Ordinary calibration as a term of the mechanics, always present; factors on what the robot file says."""

    name = "calibration"
    stage = "mechanics"
    of_the_file = True

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Precurvatures, stiffnesses, Poisson's ratios and friction of every tube and pair, with their priors."""
        numbered = list(enumerate(robot.tubes, start=1))
        curvatures = [
            Parameter(f"precurvature_factor_{i}_{k}", CURVATURE_PRIOR, neutral=1.0, lower=0.3, upper=3.0)
            for i, tube in numbered
            for k, section in enumerate(tube.sections, start=1)
            if section.curvature_per_m > 0
        ]
        stiffnesses = [
            Parameter(f"stiffness_factor_{i}", STIFFNESS_PRIOR, neutral=1.0, lower=0.1, upper=10.0) for i, _ in numbered
        ]
        ratios = [
            Parameter(f"poisson_ratio_{i}", POISSON_PRIOR, neutral=tube.poisson_ratio, lower=-0.95, upper=2.0)
            for i, tube in numbered
        ]
        frictions = [
            Parameter(f"friction_coefficient_{i}", FRICTION_PRIOR, neutral=mu, lower=0.0, upper=2.0)
            for i, mu in enumerate(robot.friction[:, 1].tolist(), start=1)
            if mu > 0
        ]
        return (*curvatures, *stiffnesses, *ratios, *frictions)

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        """The robot's numbers, by name, that these values change."""
        changed: dict[str, float] = {}
        for name, value in values.items():
            kind, *place = name.rsplit("_", 2) if name.startswith("precurvature") else name.rsplit("_", 1)
            i = int(place[0])
            if kind == "precurvature_factor":
                section = robot.tubes[i - 1].sections[int(place[1]) - 1]
                stem = f"tube.{i}.section.{place[1]}"
                changed[f"{stem}.curvature_x_per_m"] = section.curvature_x_per_m * value
                changed[f"{stem}.curvature_y_per_m"] = section.curvature_y_per_m * value
            elif kind == "stiffness_factor":
                changed[f"tube.{i}.bending_stiffness_Nm2"] = robot.tubes[i - 1].bending_stiffness_Nm2 * value
            elif kind == "poisson_ratio":
                changed[f"tube.{i}.poisson_ratio"] = value
            else:
                changed[f"contact.{i}.friction_coefficient"] = value
        return changed
