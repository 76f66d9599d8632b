"""Planning queries known to have an answer: tips of configurations that a random tree of valid motions reached.

The tree starts at a scenario's start and grows by L-shaped motions of 40 mm at most; of its tips those deepest in the
anatomy are kept, spread out, beside the scenario's own target. Only public functions of ctrplan are used here, so that
other checkouts can load the queries.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import SCENARIOS

from ctrplan import load_scenario

FILE = Path(__file__).with_suffix(".json")
TOLERANCE_MM = 1.0


@dataclass(frozen=True)
class Query:
    """A scenario with another target."""

    scenario: str
    tip_mm: tuple[float, float, float]

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.scenario} {', '.join(f'{x:.1f}' for x in self.tip_mm)}"

    def load(self, overrides: list[str]) -> Any:
        """The scenario that asks for it."""
        goal = f"goal={{tip_mm={list(self.tip_mm)}, tolerance_mm={TOLERANCE_MM}}}"
        return load_scenario(SCENARIOS / f"{self.scenario}.toml", [goal, *overrides])


def queries() -> list[Query]:
    """All queries, as kept in the file."""
    targets = json.loads(FILE.read_text(encoding="utf-8"))
    return [Query(name, (x, y, z)) for name, tips in targets.items() for x, y, z in tips]
