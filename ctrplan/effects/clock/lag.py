"""Two clocks: the pose belongs to joints of an earlier time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import Collars, Effect, Parameter, Values, register
from ctrplan.experiment.measurements import LONGEST_LAG_S, Measurements
from ctrplan.robot.robot import Robot


@register
class Lag(Effect):
    """`tau_s` [s] is how much earlier the joints are that a pose belongs to; negative if they are later."""

    name = "lag"
    stage = "clock"
    equation = "pose(t) = pose of the joints at t - tau"
    signature = "errors along the motion, in proportion to its speed"
    look_alikes = ("friction", "backlash")
    experiment = "the same path at half the speed, or a stop on the way"
    is_linear = False
    depends_on_history = True
    needs_time = True

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (Parameter("tau_s", 0.15, lower=-LONGEST_LAG_S, upper=LONGEST_LAG_S, start=0.02),)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        at_rest = "" if data.is_stream else "poses were measured at rest, not on the way"
        return super().untestable(robot, data) or at_rest

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        return [{"tau_s": 0.02}, {"tau_s": 0.15}]

    def clock(self, values: Values, data: Measurements, collars: Collars) -> Collars:
        tau = values["tau_s"]
        return Collars(_earlier(data, data.theta_b, tau), _earlier(data, data.l_b, tau))

    def delay_s(self, values: Values) -> float:
        return values["tau_s"]


def _earlier(data: Measurements, joints: Array, tau_s: float) -> Array:
    """Joints (K, n) at the poses' times minus tau, linear between waypoints; a run's ends go on as they began."""
    assert data.time_s is not None
    out = np.empty((data.count, data.n))
    for run in np.unique(data.sequence):
        waypoints, poses = np.flatnonzero(data.sequence == run), data.sequence[data.rows] == run
        times, values = data.time_s[waypoints], joints[waypoints]
        wanted = data.time_s[data.rows[poses]] - tau_s
        cell = np.clip(np.searchsorted(times, wanted) - 1, 0, len(times) - 2)
        share = (wanted - times[cell]) / np.maximum(times[cell + 1] - times[cell], 1e-9)
        out[poses] = values[cell] + share[:, None] * (values[cell + 1] - values[cell])
    return out
