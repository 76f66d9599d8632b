"""What uncertain parameters, registration and unexplained errors may do to a motion: the result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

from ctrplan.planning.uncertainty.chance import DISTRIBUTION, DRAWS, SOLVED
from ctrplan.planning.uncertainty.closest_approach import ClosestApproach
from ctrplan.planning.uncertainty.goal_miss import GoalMiss, TourMiss
from ctrplan.uncertain.parameters import UncertainParameters


@dataclass(frozen=True)
class ParameterInterval:
    """A number that is known by its 95 % interval, in the unit of its file."""

    name: str
    title: str  # for people
    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Worst cases and chances at the targets, and where the motion comes nearest to the anatomy."""

    parameters: tuple[ParameterInterval, ...]
    position_sigma_m: float  # of the base, each coordinate
    rotation_sigma_rad: float  # of the base, about each axis
    model_error_m: float  # 95th percentile of what calibration left unexplained: one pose in twenty exceeds it
    goal: GoalMiss
    closest: ClosestApproach | None  # None in free space
    distribution: str = DISTRIBUTION
    draws: int = DRAWS  # of the linearised model
    solved: int = SOLVED  # of them
    via: tuple[GoalMiss, ...] = ()  # at the targets before the goal, of a plan
    tour: TourMiss | None = None  # at all targets together; None where fewer than two can be missed
    simulated: int = 0  # of the draws: robots whose histories were simulated; 0 without a plan

    def to_json(self) -> dict[str, Any]:
        """Plain tables, for plan.json."""
        return {entry.name: _plain(getattr(self, entry.name)) for entry in fields(self)}


def intervals(parameters: UncertainParameters) -> Iterator[ParameterInterval]:
    """The parameters one by one."""
    ends = zip(parameters.value, parameters.low, parameters.high, strict=True)
    for k, (value, low, high) in enumerate(ends):
        si, name = float(parameters.si[k]), parameters.names[k]
        unit, title = parameters.unit[k], parameters.title[k]
        yield ParameterInterval(name, title, float(value) / si, float(low) / si, float(high) / si, unit)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if hasattr(value, "__dataclass_fields__"):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    return value
