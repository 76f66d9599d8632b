"""How far from a target the tip may end at worst: without friction, and what friction and play add to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ctrplan.reports.plan_words.numbers import millimetres

if TYPE_CHECKING:
    from ctrplan.planning.certified import TargetReached
    from ctrplan.planning.plan import Plan
    from ctrplan.planning.scenario import Goal


@dataclass(frozen=True)
class WorstMiss:
    """Of a target in space."""

    target: str  # "the target", or which of several
    without_friction_m: float
    friction_m: float  # the worst-case friction error
    play_m: float
    tolerance_m: float  # that the scenario asks of the tip without friction
    parameters_m: float = 0.0  # what parameters within their stated intervals add

    @property
    def total_m(self) -> float:
        """The robot model's own error is not in it, nor how well the base is registered."""
        return self.without_friction_m + self.friction_m + self.parameters_m + self.play_m

    @property
    def exceeds(self) -> bool:
        """Whether the tip may end farther away than the tolerance; also where the distance is not a number."""
        return not self.total_m <= self.tolerance_m

    @property
    def beyond_m(self) -> float:
        """How far beyond the tolerance, inf where the distance is not a number."""
        return math.inf if math.isnan(self.total_m) else self.total_m - self.tolerance_m

    @property
    def sentence(self) -> str:
        """Total beside tolerance, and what it is made of."""
        relation = "above" if self.exceeds else "within"
        parts = [f"{millimetres(self.without_friction_m)} without friction", f"{millimetres(self.friction_m)} by it"]
        parts += [f"{millimetres(self.parameters_m)} by uncertain parameters"] if self.parameters_m else []
        parts += [f"{millimetres(self.play_m)} by play"] if self.play_m else []
        return (
            f"at worst the tip ends {millimetres(self.total_m)} from {self.target}, {relation} the tolerance of "
            f"{millimetres(self.tolerance_m)} ({', '.join(parts)})"
        )


def worst_misses(plan: Plan) -> tuple[WorstMiss, ...]:
    """Of every target in space in the order reached, the goal last; none where the goal is joint values."""
    certificate, scenario, found = plan.certificate, plan.scenario, []
    for number, (goal, at) in enumerate(zip(scenario.via, certificate.targets, strict=False), start=1):
        if goal.tip_m is not None:
            name = f"target {number}{f' ({goal.name})' if goal.name else ''}"
            found.append(_miss(plan, name, goal, at))
    if scenario.goal.tip_m is not None:
        off, friction, play = certificate.goal_tip_error_m, certificate.goal_bound_m, certificate.goal_play_m
        parameters = float(certificate.samples.parameter_bound_m[-1])
        tolerance = scenario.goal.tolerance_m
        found.append(WorstMiss("the target", off, friction - parameters, play, tolerance, parameters))
    return tuple(found)


def _miss(plan: Plan, name: str, goal: Goal, at: TargetReached) -> WorstMiss:
    samples = plan.certificate.samples
    parameters = float(samples.parameter_bound_m[samples.leg <= at.leg][-1])
    return WorstMiss(name, at.tip_error_m, at.bound_m - parameters, at.play_m, goal.tolerance_m, parameters)


def worst_miss(plan: Plan) -> WorstMiss | None:
    """The one farthest beyond its tolerance, else that of the goal; None where there is none."""
    misses = worst_misses(plan)
    beyond = [miss for miss in misses if miss.exceeds]
    return max(beyond, key=lambda miss: miss.beyond_m) if beyond else misses[-1] if misses else None
