"""What plan.png and report.html show over time: curves, their limits and marks, defined once and drawn by each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ctrplan.base.arrays import Array

Dash = Literal["solid", "dotted"]


@dataclass(frozen=True, eq=False)
class Series:
    """A line over time."""

    name: str
    time_s: Array  # (K,)
    values: Array  # (K,) in the panel's unit
    colour: str
    dash: Dash = "solid"


@dataclass(frozen=True)
class Limit:
    """A value that a panel's curves should not pass."""

    value: float  # in the panel's unit
    colour: str


@dataclass(frozen=True)
class Mark:
    """A value at the end of the motion that is worth its own words."""

    text: str
    value: float  # in the panel's unit
    colour: str
    has_point: bool  # on a curve; a limit has none


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves of one quantity on one axis over time."""

    title: str
    quantity: str  # as the axis calls it
    unit: str  # empty for pure numbers
    series: tuple[Series, ...]
    limits: tuple[Limit, ...] = ()
    limits_are: str = ""  # what the dashed lines mean
    marks: tuple[Mark, ...] = ()
    from_zero: bool = True

    @property
    def label(self) -> str:
        """Of the axis: quantity and unit."""
        return f"{self.quantity} ({self.unit})" if self.unit else self.quantity

    @property
    def heading(self) -> str:
        """The title with what its dashed lines mean."""
        return f"{self.title}, dashed: {self.limits_are}" if self.limits else self.title


@dataclass(frozen=True)
class Shade:
    """The time that a leg takes, shaded by its kind."""

    start_s: float
    end_s: float
    kind: str
    colour: str


@dataclass(frozen=True)
class Timeline:
    """The axis that all panels of a plan share."""

    duration_s: float
    shades: tuple[Shade, ...]  # one per leg, in the order driven

    @property
    def end_s(self) -> float:
        """Of the axis, never 0: a motion may take no time."""
        return max(self.duration_s, 1e-3)

    @property
    def kinds(self) -> dict[str, str]:
        """Colour by kind of the legs that there are."""
        return {shade.kind: shade.colour for shade in self.shades}
