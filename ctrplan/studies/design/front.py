"""Designs that were looked at, and those of them that nothing else is better than."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from ctrplan.planning.target_set.outlook import cost, dominates
from ctrplan.studies.design.space import Design

Row = dict[str, Any]  # of the folder's rows.jsonl


@dataclass(frozen=True, eq=False)
class Looked:
    """A design and the row that came of it."""

    design: Design
    row: Row

    @property
    def numbers(self) -> dict[str, Any]:
        """What is known of it."""
        numbers: dict[str, Any] = self.row["numbers"]
        return numbers

    @property
    def is_done(self) -> bool:
        """Whether it has all numbers: it was neither given up nor refused."""
        return bool(self.row["status"] == "done")


@dataclass(eq=False)
class Archive:
    """All designs in the order in which they were proposed."""

    objectives: Sequence[str]
    all: list[Looked] = field(default_factory=list)

    def add(self, looked: Looked) -> None:
        """One more."""
        self.all.append(looked)

    def values(self, looked: Looked) -> dict[str, float]:
        """The objectives of a design that is done."""
        return {name: float(looked.numbers[name]) for name in self.objectives}

    @property
    def front(self) -> list[Looked]:
        """Designs that no other dominates, each once, the best by the first objective first."""
        done = {looked.design.key: looked for looked in reversed(self.all) if looked.is_done}
        known = [(looked, self.values(looked)) for looked in done.values()]
        kept = [looked for looked, own in known if not any(dominates(other, own) for _, other in known)]
        return sorted(kept, key=lambda looked: self._rank(looked))

    def _rank(self, looked: Looked) -> tuple[float, ...]:
        own = self.values(looked)
        return (*(cost(name, own[name]) for name in self.objectives), float(looked.row["index"]))


def judged(objectives: Iterable[str]) -> str:
    """The error that local steps lead down: the robust one where it is asked for."""
    return "robust_mm" if "robust_mm" in objectives else "error_mm"
