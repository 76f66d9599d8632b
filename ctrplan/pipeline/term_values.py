"""The parameters of several terms as one vector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.pipeline.term import Term


class TermValues:
    """Terms one after the other in vectors (P,) of SI values, with their neutral values, priors and bounds."""

    def __init__(self, terms: Sequence[Term]) -> None:
        """terms: effects, with the parameters that vary."""
        self.terms = tuple(terms)
        self.parameters = tuple(p for t in self.terms for p in t.parameters)
        self.si = np.array([p.si for p in self.parameters])
        self.neutral = np.array([p.neutral for p in self.parameters]) * self.si
        self.prior = np.array([p.prior for p in self.parameters]) * self.si
        self.lower = np.array([p.lower for p in self.parameters]) * self.si
        self.upper = np.array([p.upper for p in self.parameters]) * self.si

    @property
    def start(self) -> Array:
        """(P,) where a fit starts."""
        start: Array = np.array([p.neutral if p.start is None else p.start for p in self.parameters]) * self.si
        return start

    def slices(self) -> list[slice]:
        """Where each term's parameters stand."""
        ends = np.cumsum([len(t.parameters) for t in self.terms]).tolist()
        return [slice(end - len(t.parameters), end) for end, t in zip(ends, self.terms, strict=True)]

    def values(self, p: Array) -> list[dict[str, float]]:
        """Per term, parameter -> value, SI."""
        return [
            {q.name: float(v) for q, v in zip(t.parameters, p[s], strict=True)}
            for t, s in zip(self.terms, self.slices(), strict=True)
        ]

    def stages(self) -> dict[str, list[int]]:
        """Per stage, positions of its parameters in the vector."""
        places: dict[str, list[int]] = {"clock": [], "drive": [], "mechanics": [], "sensor": []}
        for t, s in zip(self.terms, self.slices(), strict=True):
            places[t.effect.stage] += range(s.start, s.stop)
        return places

    def of_effects_with(self, *hooks: str) -> list[int]:
        """Positions of the parameters of effects that have any of these methods of their own."""
        return [
            j
            for t, s in zip(self.terms, self.slices(), strict=True)
            if any(map(t.effect.overrides, hooks))
            for j in range(s.start, s.stop)
        ]
