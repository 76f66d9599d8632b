"""Friction that a relative translation turns axial, so that it no longer twists."""

from __future__ import annotations

import numpy as np

from ctrplan.effects.effect import MILLIMETRE, Effect, Parameter, Values, register, sliding, two_digits
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


@register
class TranslationRelease(Effect):
    """`release_per_mm` is a: a relative translation of 1/a leaves 1/e of the circumferential friction."""

    name = "translation_release"
    in_words = "friction released by translations"
    stage = "mechanics"
    equation = "d phi = d(relative rotation) / breakaway - phi |d(relative translation)| a"
    signature = "with friction in the model, poses reached by a last translation lie nearer the frictionless ones"
    look_alikes = ("friction",)
    experiment = "approach by rotation then translation of a few millimetres, and by the same in the other order"
    needs = "friction"
    depends_on_history = True
    is_linear = False

    def in_figures(self, values: Values, robot: Robot) -> str:
        far = values["release_per_mm"]
        return f"a translation of {two_digits(1 / far) if far else 'any length'} mm leaves a third of the friction"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return (Parameter("release_per_mm", 1.0, lower=0.0, upper=10.0, start=0.2, si=1 / MILLIMETRE),)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        slides = np.abs(np.diff(np.diff(data.l_commanded, axis=1), axis=0))[np.diff(data.sequence) == 0]
        if not sliding(data) or not slides.size or slides.max(initial=0.0) < 1e-5:
            return "no pose was approached by a relative translation"
        return ""

    def friction_release_m(self, values: Values) -> float:
        return 1 / max(values.get("release_per_mm", 0.0), 1e-9)
