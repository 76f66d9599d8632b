"""A term: an effect with some of its parameters at work, as fits and the diagnosis vary it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ctrplan.effects.effect import Effect, Parameter
from ctrplan.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Term:
    """An effect with some of its parameters at work; the others stay as the robot file has them, or neutral."""

    effect: Effect
    parameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """The effect's."""
        return self.effect.name

    @property
    def key(self) -> str:
        """Name and parameters: tells variants of an effect apart."""
        return f"{self.name}[{','.join(parameter.name for parameter in self.parameters)}]"


def term(effect: Effect, names: Sequence[str], robot: Robot) -> Term:
    """An effect with the named parameters at work; priors lie around the values that the robot file has."""
    given = robot.effects.get(effect.name, {})
    known = {parameter.name: parameter for parameter in effect.parameters(robot.ideal or robot)}
    for name in names:
        if name in given:
            known[name] = replace(known[name], neutral=float(given[name]), start=float(given[name]))
    return Term(effect, tuple(known[name] for name in names))
