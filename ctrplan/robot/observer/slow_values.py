"""Slow parameters with the values that a robot file has for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np

from ctrplan.errors import InputError
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.tube import SOFTEST_NM2
from ctrplan.robot.named_numbers import Numbered, value_of, with_values
from ctrplan.robot.observer.slow_parameter import SlowParameter

LEAST = {"friction_coefficient": 0.0, "clearance_m": 1e-6, "length_m": 1e-3, "bending_stiffness_Nm2": SOFTEST_NM2}


class Followable(Numbered, Protocol):
    """A robot with its mechanics."""

    @property
    def n(self) -> int:
        """Number of tubes."""

    @property
    def mechanics(self) -> Mechanics:
        """Its compiled model."""


def values_of_slow(robot: Followable, slow: Sequence[SlowParameter]) -> dict[SlowParameter, float]:
    """Each with its value, SI, zero for the zeros of collars. Raises InputError for names that the robot lacks."""
    for parameter in slow:
        if not isinstance(parameter, SlowParameter):
            raise InputError("must be a list of SlowParameter", key="slow", value=parameter)
    names = [parameter.name for parameter in slow]
    for name in names:
        if names.count(name) > 1:
            raise InputError("is named twice", key=name)
    nowhere = np.zeros((0, robot.n))
    robot.mechanics.tips_with_friction(nowhere, nowhere, nowhere[:, 1:], parameters=names)  # refuses unknown names
    return {p: 0.0 if p.is_of_collar else value_of(robot, p.name) for p in slow}


def robot_with(robot: Followable) -> Callable[[Mapping[str, float]], Mechanics]:
    """The robot's mechanics with named numbers so much off its own."""

    def changed(off: Mapping[str, float]) -> Mechanics:
        values = {name: _possible(name, value_of(robot, name) + by) for name, by in off.items() if by}
        return with_values(robot, values).mechanics

    return lambda off: changed(off) if any(off.values()) else robot.mechanics


def _possible(name: str, value: float) -> float:
    least = next((least for key, least in LEAST.items() if name.endswith(key)), -np.inf)
    return max(value, least)
