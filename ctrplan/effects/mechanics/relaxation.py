"""Friction that lets go while the robot rests: contacts creep, and the tip after them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import Effect, Parameter, Values, register, two_digits
from ctrplan.measurement.approach import time_at_rest_s
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

TIME_S = 5.0  # where nothing is said of it
LEAST_REST_S = 0.5


@register
class Relaxation(Effect):
    """`released_share` a of the friction state is gone after a long rest, 1 - 1/e of that after `time_s` [s]."""

    name = "relaxation"
    in_words = "creep after a motion"
    stage = "mechanics"
    equation = "phi(t) = phi (1 - a (1 - exp(-t / T))), t since the last joint moved"
    signature = "with friction in the model, the tip creeps towards the frictionless one while nothing moves"
    look_alikes = ("friction", "drift", "translation_release")
    experiment = "stop after a rotation by 90 deg and log for a minute, from both sides"
    needs = "friction"
    acts_at_rest = False
    depends_on_history = True
    is_linear = False
    needs_time = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        gone = f"{two_digits(100 * values['released_share'])} %" if "released_share" in values else "a part"
        within = f", most of it within {two_digits(values['time_s'])} s" if "time_s" in values else ""
        return f"at rest {gone} of the friction goes{within}"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (
            Parameter("released_share", 0.4, lower=0.0, upper=1.0, start=0.1),
            Parameter("time_s", 10.0, neutral=TIME_S, lower=0.05, upper=1e5),
        )

    def untestable(self, robot: Robot, data: Measurements) -> str:
        if reason := super().untestable(robot, data):
            return reason
        rest_s = time_at_rest_s(data)
        return "" if np.ptp(rest_s) > LEAST_REST_S else "no pose was measured again while the robot rested"

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        return [{"released_share": 0.3, "time_s": time_s} for time_s in (1.0, 20.0)]

    def friction_share(self, values: Values, data: Measurements) -> Array | float:
        gone = -np.expm1(-time_at_rest_s(data) / values.get("time_s", TIME_S))
        share: Array = 1 - values.get("released_share", 0.0) * gone[:, None]
        return share
