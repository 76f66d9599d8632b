"""Tubes that bend more easily about one of their own axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ctrplan.effects.effect import Effect, Parameter, Values, joined_clauses, register, vectors
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


@register
class Ovality(Effect):
    """`cos_I` and `sin_I` of tube I: relative difference e of its two stiffnesses, times cos and sin of 2a; no unit."""

    name = "ovality"
    in_words = "tubes that are not round"
    stage = "mechanics"
    equation = "EI (1 + e) and EI (1 - e) about two own axes; cos, sin: e cos 2a, e sin 2a with the stiff axis at a"
    signature = "errors with twice the relative angle, all approaches alike"
    look_alikes = ("off_plane_precurvature", "nonlinear_elasticity")
    experiment = "one full turn of the tube in fine steps at small extension"

    def in_figures(self, values: Values, robot: Robot) -> str:
        text = "tube {I} is {value} % stiffer about one axis and as much softer about the other"
        return joined_clauses(vectors(values, ("sin_I", "cos_I"), text, factor=100))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{part}_{i + 1}", 0.1, lower=-0.9, upper=0.9, start=1e-3)
            for i in range(robot.n)
            for part in ("cos", "sin")
        )

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        each = [[f"cos_{i + 1}", f"sin_{i + 1}"] for i in range(robot.n)]
        return [*each, [name for names in each for name in names]] if robot.n > 1 else each

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        changed = {}
        for tube in {name.split("_")[1] for name in values}:
            cos, sin = values.get(f"cos_{tube}", 0.0), values.get(f"sin_{tube}", 0.0)
            changed[f"tube.{tube}.ovality"] = math.hypot(cos, sin)
            changed[f"tube.{tube}.ovality_axis_rad"] = math.atan2(sin, cos) / 2
        return changed
