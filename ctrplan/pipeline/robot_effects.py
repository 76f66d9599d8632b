"""[effects.*] of a robot file: read strictly, put to work in the robot's tubes, contacts, loads and drive.

Effects of the clock and of the sensor wait for the chain: they change what is measured, not where the robot is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.robot.named_numbers import with_values

if TYPE_CHECKING:
    from ctrplan.effects.effect import Effect
    from ctrplan.robot.robot import Robot
    from ctrplan.storage.toml_document import Document

NOTES = ("ci95", "provenance")  # keys of an effect's table that say where its values come from


def effects_of(robot: Robot) -> list[tuple[Effect, dict[str, float]]]:
    """The robot's effects with their parameters, SI, in the order of the file."""
    from ctrplan.effects.catalogue import CATALOGUE

    found = []
    for name, table in robot.effects.items():
        effect = CATALOGUE[name]
        si = {parameter.name: parameter.si for parameter in effect.parameters(robot)}
        found.append((effect, {key: float(value) * si[key] for key, value in table.items() if key not in NOTES}))
    return found


def check_effects(robot: Robot, document: Document) -> None:
    """Raises InputError for an effect that is not in the catalogue and for parameters it does not have."""
    from ctrplan.effects.catalogue import CATALOGUE

    for name, table in robot.effects.items():
        if name not in CATALOGUE:
            raise document.fault(f"unknown effect, known ones are {', '.join(CATALOGUE)}", "effects", name)
        known = {parameter.name: parameter for parameter in CATALOGUE[name].parameters(robot)}
        for key, value in table.items():
            if key in NOTES:
                continue
            if key not in known:
                raise document.fault(f"unknown parameter, known ones are {', '.join(known)}", "effects", name, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise document.fault("must be a number", "effects", name, key)
            low, high = known[key].lower, known[key].upper
            if not low <= value <= high:
                raise document.fault(f"must be from {low:g} to {high:g}", "effects", name, key)


def with_effects(robot: Robot) -> Robot:
    """The robot with its effects of mechanics and drive at work."""
    for effect, values in effects_of(robot):
        if effect.stage == "mechanics":
            robot = with_values(robot, effect.mechanics(values, robot))
        elif effect.stage == "drive" and effect.acts_at_rest:
            robot = replace(robot, drive=replace(robot.drive, terms=(*robot.drive.terms, _DriveTerm(effect, values))))
        elif effect.stage == "drive":
            robot = replace(robot, drive=replace(robot.drive, play=_play(effect, values, robot.n)))
    return robot


def _play(effect: Effect, values: Mapping[str, float], n: int) -> tuple[Array, Array]:
    """(n,) [rad], (n,) [m] how far an effect that depends on directions moves the collars, every way the same."""
    from ctrplan.effects.effect import Collars

    moved = effect.drive(values, Collars(np.zeros((1, n)), np.zeros((1, n))), np.ones((1, 2 * n)))
    return np.abs(moved.theta[0]), np.abs(moved.l[0])


@dataclass(frozen=True)
class _DriveTerm:
    """An effect on collars (K, n), (K, n) whose last direction nobody knows."""

    effect: Effect
    values: Mapping[str, float]

    def __call__(self, theta: Array, l: Array) -> tuple[Array, Array]:  # noqa: E741 (as in the equations)
        from ctrplan.effects.effect import Collars

        moved = self.effect.drive(self.values, Collars(theta, l), np.zeros((len(theta), 2 * theta.shape[1])))
        return moved.theta, moved.l
