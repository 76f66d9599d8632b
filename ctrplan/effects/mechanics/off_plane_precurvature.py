"""Precurvature about the other axis of a curved section."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ctrplan.effects.effect import Effect, Parameter, Values, clauses, joined_clauses, register
from ctrplan.robot.robot import Robot


@register
class OffPlanePrecurvature(Effect):
    """`delta_I_K_per_m` [1/m] is added across the drawn precurvature of section K (from 1, at the base) of tube I."""

    name = "off_plane_precurvature"
    in_words = "precurvature out of its plane"
    stage = "mechanics"
    equation = "u_hat += delta e, e across the drawn precurvature (Tables VI, VII)"
    signature = "the robot bends as if a tube were turned by a constant angle"
    look_alikes = ("homing_offset", "base_misalignment")
    experiment = "retract the curved section of the tube: an angle offset stays, an off-plane curvature goes with it"

    def in_figures(self, values: Values, robot: Robot) -> str:
        text = "section {K} of tube {I} is curved out of its plane by {value} 1/m"
        return joined_clauses(clauses(values, "delta_I_K_per_m", text))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"delta_{i + 1}_{k + 1}_per_m", max(0.15 * section.curvature_per_m, 0.1), lower=-1e3, upper=1e3)
            for i, tube in enumerate(robot.tubes)
            for k, section in enumerate(tube.sections)
            if section.curvature_per_m > 0
        )

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        changed = {}
        for name, delta in values.items():
            i, k = map(int, name.split("_")[1:3])
            section = robot.tubes[i - 1].sections[k - 1]
            u = np.array([section.curvature_x_per_m, section.curvature_y_per_m])
            across = np.array([u[1], -u[0]]) / np.linalg.norm(u)
            for axis, value in zip("xy", u + delta * across, strict=True):
                changed[f"tube.{i}.section.{k}.curvature_{axis}_per_m"] = float(value)
        return changed
