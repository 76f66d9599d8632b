"""Precurvature that changes linearly along a section."""

from __future__ import annotations

from collections.abc import Mapping

from ctrplan.effects.effect import Effect, Parameter, Values, clauses, joined_clauses, register
from ctrplan.robot.robot import Robot


@register
class VaryingPrecurvature(Effect):
    """`gradient_I_K` is g of section K of tube I: the relative change from its middle to its end, no unit."""

    name = "varying_precurvature"
    in_words = "precurvature that varies along a section"
    stage = "mechanics"
    equation = "u_hat(x) = u_hat (1 + g (2 x / L - 1)), x from the section's base"
    signature = "errors that grow and change sign as a curved section is extended"
    look_alikes = ("clearance", "nonlinear_elasticity", "joint_scale")
    experiment = "the curved section of one tube at several extensions, the others aligned"

    def in_figures(self, values: Values, robot: Robot) -> str:
        text = "section {K} of tube {I} is {value} % {sign} curved at its end than in its middle"
        return joined_clauses(clauses(values, "gradient_I_K", text, signs=("more", "less"), factor=100))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"gradient_{i + 1}_{k + 1}", 0.2, lower=-1.0, upper=1.0)
            for i, tube in enumerate(robot.tubes)
            for k, section in enumerate(tube.sections)
            if section.curvature_per_m > 0
        )

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        places = {name: name.split("_")[1:] for name in values}
        return {f"tube.{i}.section.{k}.gradient": values[name] for name, (i, k) in places.items()}
