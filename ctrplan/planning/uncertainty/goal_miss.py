"""How far from a target the tip may end, with every friction state and everything uncertain: the results."""

from __future__ import annotations

from dataclasses import dataclass

from ctrplan.planning.uncertainty.chance import Chance
from ctrplan.planning.uncertainty.contributors import Contributor, TurnContributor


@dataclass(frozen=True, eq=False)
class TurnMiss:
    """Angles of the tip's tangent from a target's direction; registration and play turn it too."""

    worst_rad: float  # every friction state, parameters anywhere in their box, base in its 95 % ball
    contributors: tuple[TurnContributor, ...]  # largest first; their shares add up to `worst_rad`
    friction_state: tuple[float, ...]  # phi of the worst case
    beyond_first_order_rad: float  # in `worst_rad`
    tolerance_rad: float
    chance_any_friction: Chance  # of being turned by more than the tolerance in the worst of all friction states
    chance_by_history: Chance | None  # and with friction as simulated from the plan's start
    quantile_any_friction_rad: float  # 95 % of robots are turned by less, in the worst friction state
    quantile_by_history_rad: float | None
    sentence: str


@dataclass(frozen=True, eq=False)
class GoalMiss:
    """Distances of the tip from a target's; for one in joint values, from where the frictionless tip shall be."""

    worst_m: float  # every friction state, parameters anywhere in their box, base and unexplained error in 95 % balls
    contributors: tuple[Contributor, ...]  # largest first; their shares add up to `worst_m`
    friction_state: tuple[float, ...]  # phi of the worst case
    beyond_first_order_m: float  # by how much the solved worst case differs from the linear one; in `worst_m`
    tolerance_m: float | None
    chance_any_friction: Chance | None  # of missing a tolerance, the direction's included, in the worst friction state
    chance_by_history: Chance | None  # and with friction as simulated from the plan's start
    quantile_any_friction_m: float  # 95 % of robots miss by less, in the worst friction state
    quantile_by_history_m: float | None
    sentence: str
    name: str = ""  # of the target
    sample: int | None = None  # of the path, where the worst case is: on the way along a line, else at its end
    turn: TurnMiss | None = None  # None without a direction


@dataclass(frozen=True)
class TourMiss:
    """Chances of missing at least one of several targets; those in joint values can't be missed."""

    targets: int  # that can be
    chance_any_friction: Chance  # in the worst friction state at each
    chance_by_history: Chance | None  # with friction as simulated through all of them
