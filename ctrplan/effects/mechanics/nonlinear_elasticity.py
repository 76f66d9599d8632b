"""Tubes that soften beyond a strain, as superelastic ones do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ctrplan.effects.effect import Effect, Parameter, Values, register, two_digits
from ctrplan.robot.robot import Robot


@register
class NonlinearElasticity(Effect):
    """Every tube softens alike: beyond `strain_percent` its tangent stiffness is `stiffness_fraction` of EI."""

    name = "nonlinear_elasticity"
    in_words = "softening of strongly bent tubes"
    stage = "mechanics"
    equation = "bending stiffness falls to a fraction where r_out |u - u_hat| exceeds a strain, bilinear"
    signature = "errors where a strongly curved tube is straightened, all approaches alike"
    look_alikes = ("varying_precurvature", "shaft_torsion")
    experiment = "the most curved tube inside the stiffest section, aligned and opposed"
    is_linear = False

    def in_figures(self, values: Values, robot: Robot) -> str:
        strain, left = values.get("strain_percent"), values.get("stiffness_fraction")
        beyond = "strongly bent" if strain is None else f"beyond a strain of {two_digits(strain)} %"
        return f"{beyond} tubes keep {'a part' if left is None else f'{two_digits(100 * left)} %'} of their stiffness"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (
            Parameter("strain_percent", 1.0, neutral=1.0, lower=0.05, upper=8.0, start=0.8, si=0.01),
            Parameter("stiffness_fraction", 0.5, neutral=1.0, lower=0.02, upper=1.0, start=0.8),
        )

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        return [{"strain_percent": strain} for strain in (0.4, 0.8, 1.2)]

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        return {
            f"tube.{i + 1}.{key}": value
            for i in range(robot.n)
            for key, value in (
                ("softening_strain", values.get("strain_percent", 0.01)),
                ("softening_fraction", values.get("stiffness_fraction", 1.0)),
            )
        }
