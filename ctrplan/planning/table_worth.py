"""Whether a table of bounds helps to plan a scenario: the same motions checked with it and without, before the search.

What counts is the scenario: near walls a looked-up shape that is too thick is refused, and solved after all; where the
table has no answer it is asked in vain; and bounds that are too large here and exact there make a search choose badly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.motion.bound_table import BoundTable, known_table
from ctrplan.motion.checker import DEFINITE_COLLISION_M, Motion, MotionChecker

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

STATES, MOTIONS = 3000, 24  # of a narrow lumen few states are clear
SEED, CLEARLY = 11, 0.1


@dataclass(frozen=True)
class TableWorth:
    """What a table saves and spoils on some motions of a scenario."""

    motions: int
    work: float  # share of the work without the table, as a search's meter counts it
    lost: float  # share of what choosing the cheaper of two motions is worth, lost by looked-up costs

    @property
    def helps(self) -> bool:
        """Whether more of the work is saved than of the choice is lost, by more than few motions show by chance."""
        return 1 - self.work > self.lost + CLEARLY

    @property
    def sentence(self) -> str:
        """What was measured and what follows."""
        follows = "it is used" if self.helps else "it is left alone"
        return (
            f"On {self.motions} motions of this scenario the robot's bound field takes {100 * self.work:.0f} % of the "
            f"work without it, and spoils {100 * self.lost:.0f} % of what choosing between them is worth: {follows}."
        )


def helpful_table(scenario: Scenario) -> tuple[BoundTable | None, str]:
    """The table of the scenario's robot if it was built before and helps here, and the sentence; "" without a table."""
    table = known_table(scenario.robot)
    if table is None:
        return None, ""
    worth = table_worth(scenario, table)
    return (table if worth.helps else None), worth.sentence


def table_worth(scenario: Scenario, table: BoundTable) -> TableWorth:
    """Checks motions between neighbours among clear random states both ways; counted, so the same everywhere."""
    without, looked_up = MotionChecker(scenario), MotionChecker(scenario, bound_table=table)
    pairs = _neighbours(without)
    true = [without.motion(a, b) for a, b in pairs]
    found = [looked_up.motion(a, b) for a, b in pairs]
    work = looked_up.meter.spent_ns / max(without.meter.spent_ns, 1)
    both = [k for k in range(len(pairs)) if true[k].valid and found[k].valid]
    return TableWorth(len(pairs), work, _lost(_costs(without, true, both), _costs(looked_up, found, both)))


def _neighbours(checker: MotionChecker) -> list[tuple[Array, Array]]:
    """Random states whose zero-clearance shapes do not collide, or the least bad, each with the nearest other one."""
    q = checker.space.sample(np.random.default_rng(SEED), STATES)
    rooms = checker.rooms([state[None] for state in q])
    clear = np.flatnonzero(rooms > DEFINITE_COLLISION_M)
    kept = q[clear if len(clear) >= 2 else np.argsort(-rooms)[:2]]
    checker.meter.spent_ns = 0  # of looking for them
    pairs = []
    for k in range(min(MOTIONS, len(kept))):
        apart = np.linalg.norm(checker.space.difference(kept[k], kept) * checker.space.weights_mm, axis=1)
        apart[k] = np.inf
        pairs.append((kept[k], kept[apart.argmin()]))
    return pairs


def _costs(checker: MotionChecker, motions: list[Motion], rows: list[int]) -> Array:
    """(R,) [mm] as if the goal was at their end, where bounds weigh most."""
    return np.array([checker.cost_mm(motions[k], ends_at_goal=True) for k in rows])


def _lost(true: Array, looked_up: Array) -> float:
    """Of all pairs: differences of the true costs where the looked-up ones choose the dearer one, over all of them."""
    gap = np.triu(np.abs(true[:, None] - true[None]), 1)
    wrong = (true[:, None] - true[None]) * (looked_up[:, None] - looked_up[None]) < 0
    return float(gap[wrong].sum() / gap.sum()) if gap.any() else 0.0
