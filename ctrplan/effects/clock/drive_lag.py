"""A drive that follows late, its rotations by another time than its translations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import Effect, Parameter, Values, joined_clauses, register, sliding, turning, two_digits
from ctrplan.measurement.measurements import LONGEST_LAG_S, Measurements
from ctrplan.robot.robot import Robot


@register
class DriveLag(Effect):
    """`theta_s`, `l_s` [s]: how much later than commanded rotations and translations happen; `lag` is the tracker's."""

    name = "drive_lag"
    in_words = "drive that follows late"
    stage = "clock"
    equation = "theta(t) = commanded theta(t - theta_s), l(t) = commanded l(t - l_s)"
    signature = "errors in proportion to the speed of rotations, or of translations, not of both alike"
    look_alikes = ("lag", "backlash", "friction")
    experiment = "rotations alone and translations alone, each at two speeds: a late tracker delays both alike"
    is_linear = False
    depends_on_history = True
    needs_time = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        late = {"theta_s": "rotations follow {} s late", "l_s": "translations follow {} s late"}
        return joined_clauses([(value, late[name].format(two_digits(value))) for name, value in values.items()])

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(Parameter(name, 0.15, lower=0.0, upper=LONGEST_LAG_S, start=0.02) for name in ("theta_s", "l_s"))

    def untestable(self, robot: Robot, data: Measurements) -> str:
        if reason := super().untestable(robot, data):
            return reason
        if not data.is_stream:
            return "poses were measured at rest, not on the way"
        if turning(data) and sliding(data):
            return ""
        return "rotations and translations do not both move: a delay of the tracker says the same"

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        return [["theta_s"], ["l_s"]]

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        return [dict.fromkeys(names, 0.02), dict.fromkeys(names, 0.15)]

    def drive_delays_s(self, values: Values, n: int) -> Array:
        return np.repeat([values.get("theta_s", 0.0), values.get("l_s", 0.0)], n)
