"""Radial gaps that differ from the drawing's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ctrplan.effects.effect import MILLIMETRE, Effect, Parameter, Values, clauses, joined_clauses, register
from ctrplan.robot.robot import Robot

STARTS_MM = (0.0, 0.15, 0.4)  # tubes that touch all along bend as one, with room they don't: no small step tells


@register
class Clearance(Effect):
    """`delta_I_mm` is added to the radial clearance c_I of tubes I and I + 1, of which a tenth always stays."""

    name = "clearance"
    in_words = "room between the tubes"
    stage = "mechanics"
    equation = "|d_i| <= c_i + delta_i, (14)"
    signature = "errors where curvatures oppose and inner tubes tilt in outer ones, all approaches alike"
    look_alikes = ("shaft_torsion", "varying_precurvature")
    experiment = "tubes retracted against tubes extended, at the same relative angles"
    is_linear = False

    def in_figures(self, values: Values, robot: Robot) -> str:
        text = "tubes {I} and {next} have {value} mm {sign} radial clearance"
        return joined_clauses(clauses(values, "delta_I_mm", text, signs=("more", "less")))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"delta_{i + 1}_mm", 0.05, lower=-0.9 * c * 1e3, upper=1.0, si=MILLIMETRE)
            for i, c in enumerate(robot.clearance_m.tolist())
        )

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        return [dict.fromkeys(names, start) for start in STARTS_MM]

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        pairs = {name: int(name.split("_")[1]) for name in values}
        return {
            f"contact.{pair}.clearance_m": robot.clearance_m[pair - 1] + values[name] for name, pair in pairs.items()
        }
