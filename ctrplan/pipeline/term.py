"""Terms: effects with some of their parameters at work, the vector of these parameters, and what a sensor should
read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import Effect, Parameter
from ctrplan.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class SensorPrediction:
    """What the sensor should read at K poses, and derivatives by the P parameters of all terms."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    sound: NDArray[np.bool_]  # (K,)
    failed: NDArray[np.bool_]  # (K,) without a solution: position and tangent are those of the last iterate
    position_by: Array  # (K, 3, P)
    tangent_by: Array  # (K, 3, P)

    def subset(self, poses: NDArray[np.bool_]) -> SensorPrediction:
        """Some of the poses only, given by a mask (K,)."""
        return SensorPrediction(*(getattr(self, name)[poses] for name in SensorPrediction.__dataclass_fields__))


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


class TermValues:
    """Terms one after the other in vectors (P,) of SI values, with their neutral values, priors and bounds."""

    def __init__(self, terms: Sequence[Term]) -> None:
        """terms: effects, with the parameters that vary."""
        self.terms = tuple(terms)
        self.parameters = tuple(p for t in self.terms for p in t.parameters)
        self.keys = tuple((t.name, p.name) for t in self.terms for p in t.parameters)
        self.si = np.array([p.si for p in self.parameters])
        self.neutral = np.array([p.neutral for p in self.parameters]) * self.si
        self.prior = np.array([p.prior for p in self.parameters]) * self.si
        self.lower = np.array([p.lower for p in self.parameters]) * self.si
        self.upper = np.array([p.upper for p in self.parameters]) * self.si
        ends = np.cumsum([len(t.parameters) for t in self.terms]).tolist()
        self._slices = [slice(end - len(t.parameters), end) for end, t in zip(ends, self.terms, strict=True)]
        self._names = [[q.name for q in t.parameters] for t in self.terms]
        self._stages: dict[str, list[int]] = {"clock": [], "drive": [], "mechanics": [], "sensor": []}
        for t, s in zip(self.terms, self._slices, strict=True):
            self._stages[t.effect.stage] += range(s.start, s.stop)

    @property
    def owners(self) -> tuple[str, ...]:
        """Name of the effect of each parameter, (P,)."""
        return tuple(name for name, _ in self.keys)

    @property
    def start(self) -> Array:
        """(P,) where a fit starts."""
        start: Array = np.array([p.neutral if p.start is None else p.start for p in self.parameters]) * self.si
        return start

    def slices(self) -> list[slice]:
        """Where each term's parameters stand."""
        return self._slices

    def values(self, p: Array) -> list[dict[str, float]]:
        """Per term, parameter -> value, SI."""
        numbers = p.tolist()
        return [dict(zip(names, numbers[s], strict=True)) for names, s in zip(self._names, self._slices, strict=True)]

    def stages(self) -> dict[str, list[int]]:
        """Per stage, positions of its parameters in the vector."""
        return self._stages

    def of_effects_with(self, *hooks: str) -> list[int]:
        """Positions of the parameters of effects that have any of these methods of their own."""
        return [
            j
            for t, s in zip(self.terms, self.slices(), strict=True)
            if any(map(t.effect.overrides, hooks))
            for j in range(s.start, s.stop)
        ]
