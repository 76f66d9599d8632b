"""Two clocks: the pose belongs to joints of an earlier time."""

from __future__ import annotations

from collections.abc import Sequence

from ctrplan.effects.effect import Effect, Parameter, Values, register, two_digits
from ctrplan.measurement.measurements import LONGEST_LAG_S, Measurements
from ctrplan.robot.robot import Robot


@register
class Lag(Effect):
    """`tau_s` [s] is how much earlier the joints are that a pose belongs to; negative if they are later."""

    name = "lag"
    in_words = "delay between joints and poses"
    stage = "clock"
    equation = "pose(t) = pose of the joints at t - tau"
    signature = "errors along the motion, in proportion to its speed"
    look_alikes = ("friction", "backlash")
    experiment = "the same path at half the speed, or a stop on the way"
    is_linear = False
    depends_on_history = True
    needs_time = True

    def in_figures(self, values: Values, robot: Robot) -> str:
        late = values["tau_s"]
        return f"poses are stamped {two_digits(abs(late))} s {'late' if late > 0 else 'early'}"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (Parameter("tau_s", 0.15, lower=-LONGEST_LAG_S, upper=LONGEST_LAG_S, start=0.02),)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        at_rest = "" if data.is_stream else "poses were measured at rest, not on the way"
        return super().untestable(robot, data) or at_rest

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        return [{"tau_s": 0.02}, {"tau_s": 0.15}]

    def delay_s(self, values: Values) -> float:
        return values.get("tau_s", 0.0)
