"""Friction that is smaller on the way than at rest (Stribeck)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import DEGREE, Effect, Parameter, Values, register, two_digits
from ctrplan.measurement.approach import turning_speeds
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

SPEED_DEG_S = 5.0  # where nothing is said of it


@register
class FrictionSpeed(Effect):
    """`moving_share` m of the coefficient is left at high speed, `speed_deg_s` s is where 1/e of the rest is.

    Speeds are those of the tubes of a pair against each other. m is at most 1, so that bounds hold on the way too.
    """

    name = "friction_speed"
    in_words = "friction that depends on speed"
    stage = "mechanics"
    equation = "mu(v) = mu (m + (1 - m) exp(-|v| / s))"
    signature = "with friction in the model, slow poses lie farther from the frictionless ones than fast ones"
    look_alikes = ("friction", "lag", "drive_lag")
    experiment = "the same path slowly and ten times as fast"
    needs = "friction"
    acts_at_rest = False
    depends_on_history = True
    is_linear = False
    needs_time = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        left = f"{two_digits(100 * values['moving_share'])} %" if "moving_share" in values else "a part"
        from_on = f", from some {two_digits(values['speed_deg_s'])} deg/s on" if "speed_deg_s" in values else ""
        return f"in fast motion {left} of the friction is left{from_on}"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (
            Parameter("moving_share", 0.5, neutral=1.0, lower=0.0, upper=1.0, start=0.8),
            Parameter("speed_deg_s", 10.0, neutral=SPEED_DEG_S, lower=0.1, upper=1e3, si=DEGREE),
        )

    def untestable(self, robot: Robot, data: Measurements) -> str:
        if reason := super().untestable(robot, data):
            return reason
        if robot.n < 2 or not data.is_stream:
            return "one tube rubs on nothing" if robot.n < 2 else "poses were measured at rest, not on the way"
        speeds = np.abs(turning_speeds(data)).max(axis=1)
        return "" if np.ptp(speeds) > DEGREE else "all poses were passed at the same speed"

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        return [["moving_share", "speed_deg_s"]]

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        return [{"moving_share": 0.5, "speed_deg_s": s} for s in (2.0, 20.0)]

    def friction_share(self, values: Values, data: Measurements) -> Array | float:
        if not data.is_stream or data.time_s is None:
            return 1.0
        slow = np.exp(-np.abs(turning_speeds(data)) / values.get("speed_deg_s", SPEED_DEG_S * DEGREE))
        m = values.get("moving_share", 1.0)
        share: Array = m + (1 - m) * slow
        return share
