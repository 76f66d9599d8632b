"""Markers along the body: points of a tube whose positions a camera or a tracker measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ctrplan.base.arguments import Choice, Number, Whole, checked


@checked(
    tube=Whole(1, 1000),
    distance_m=Number(0, 10, "m"),
    end=Choice("tip", "base"),
    position_sigma_m=Number(1e-9, 1, "m"),
)
@dataclass(frozen=True)
class Marker:
    """A marker around a tube, its middle on the tube's centreline, at an arc length from one of the tube's ends."""

    name: str
    tube: int  # from 1, outermost first
    distance_m: float  # along the tube, from its tip or its base
    end: Literal["tip", "base"] = "tip"
    position_sigma_m: float | None = None  # noise of each coordinate; None: that of the tip

    def along_m(self, length_m: float) -> float:
        """Arc length [m] from the base of a tube of this length; a marker stays at its distance if lengths change."""
        return length_m - self.distance_m if self.end == "tip" else self.distance_m

    def is_tip(self, tubes: int) -> bool:
        """Whether it is the tip of the innermost of so many tubes itself."""
        return self.tube == tubes and self.end == "tip" and self.distance_m == 0

    @property
    def columns(self) -> tuple[str, str, str]:
        """Names of its columns in measurements and tables."""
        return f"{self.name}_x_m", f"{self.name}_y_m", f"{self.name}_z_m"
