"""Values of every effect away from where it vanishes, and data on which it acts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from made_up_input import FUZZ

from ctrplan.effects.effect import CATALOGUE
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

OF_CONTINUOUS_MOTIONS = ("lag", "drive_lag", "translation_release", "friction_speed", "relaxation")


def table(name: str, robot: Robot, share: float = 0.2) -> dict[str, float]:
    """[effects.NAME] with every parameter `share` of its prior away from neutral, in the units of the file."""
    values = {}
    for k, parameter in enumerate(CATALOGUE[name].parameters(robot)):
        value = parameter.neutral + share * (1 + 0.1 * (k % 3)) * parameter.prior
        if parameter.name in ("stiffness_fraction", "strain_percent"):
            value = 0.6
        if parameter.name == "l_1_mm":  # the base of tube 1 can't be in front of the plate
            value = -1.0 if name == "homing_offset" else value
        values[parameter.name] = float(np.clip(value, parameter.lower, parameter.upper))
    return values


def effects(names: Sequence[str], robot: Robot) -> dict[str, dict[str, float]]:
    """[effects.*] of a robot file."""
    return {name: table(name, robot) for name in names}


def continuous_motion() -> Measurements:
    """A motion with every waypoint measured; poses are zero."""
    time = np.arange(12) * 0.1
    theta = np.column_stack([0 * time, 0.3 + 1.1 * time + 0.4 * np.sin(4 * time)])
    nothing = np.zeros((12, 3))
    l = np.column_stack([0 * time - 2e-3, -0.02 + 0.004 * time])  # noqa: E741 (as in the equations)
    return Measurements(np.zeros(12, int), theta, l, np.arange(12), nothing, nothing, time, True)


def pairs_of(names: Sequence[str]) -> list[tuple[str, str]]:
    """Each name with the next one; with CTRPLAN_FUZZ set every two."""
    return list(itertools.combinations(names, 2)) if FUZZ else list(zip(names, [*names[1:], names[0]], strict=True))


def one_of_each_stage() -> list[str]:
    """The first effect of each stage; with CTRPLAN_FUZZ set all effects."""
    stages = [CATALOGUE[name].stage for name in CATALOGUE]
    return [name for k, name in enumerate(CATALOGUE) if FUZZ or stages[k] not in stages[:k]]
