"""Tubes that lose precurvature with use."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import Effect, Parameter, Values, clauses, joined_clauses, register
from ctrplan.measurement.approach import use_left
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

LEAST_TURN_RAD = 2 * np.pi  # of use; less changes no tube


@register
class PrecurvatureLoss(Effect):
    """`loss_I_percent`: by how much more tube I was curved at the first pose than at the last, over all its sections.

    A robot file has the robot of the last pose, which others than fits ask about: there the effect does nothing.
    """

    name = "precurvature_loss"
    in_words = "precurvature lost with use"
    stage = "mechanics"
    equation = "u_hat = u_hat at the end (1 + loss w), w the share of all turning against each other still to come"
    signature = "errors of curved tubes that grow with what has been done, and do not recover overnight"
    acts_at_rest = False
    look_alikes = ("drift", "joint_scale")
    experiment = "repeat the first configurations at the end, and once more after a night: a drift of the clock goes on"

    def in_figures(self, values: Values, robot: Robot) -> str:
        text = "tube {I} was {value} % {sign} curved at the first pose than at the last"
        return joined_clauses(clauses(values, "loss_I_percent", text, signs=("more", "less")))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        curved = (i for i, tube in enumerate(robot.tubes, 1) if any(s.curvature_per_m > 0 for s in tube.sections))
        return tuple(Parameter(f"loss_{i}_percent", 3.0, lower=-30.0, upper=30.0, si=0.01) for i in curved)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        if not self.parameters(robot):
            return "no tube is curved"
        turns = np.abs(np.diff(np.diff(data.theta_commanded, axis=1), axis=0)).sum()
        return "" if turns > LEAST_TURN_RAD else "the tubes were hardly used"

    def changing(self, values: Values, robot: Robot, data: Measurements) -> Mapping[str, Array]:
        left, changes = use_left(data), dict[str, Array]()
        for name, loss in values.items():
            i = int(name.split("_")[1])
            for k, section in enumerate(robot.tubes[i - 1].sections, start=1):
                for axis, curvature in (("x", section.curvature_x_per_m), ("y", section.curvature_y_per_m)):
                    if curvature:
                        changes[f"tube.{i}.section.{k}.curvature_{axis}_per_m"] = loss * curvature * left
        return changes
