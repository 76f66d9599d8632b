"""Whether the bodies of simulated histories keep clear of the anatomy, whatever the walk says of friction states."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.units import MM_PER_M
from ctrplan.mechanics.shapes import Shape
from ctrplan.planning.certificate.allowances import BEYOND_BOUND_M
from ctrplan.planning.certificate.anatomy_distance import AnatomyDistance

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


@dataclass(eq=False)
class SimulatedBodies:
    """Is shown shapes, from several threads, and keeps the least clearance."""

    distance: AnatomyDistance
    clearances_m: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, scenario: Scenario) -> SimulatedBodies | None:
        """None in free space."""
        distance = AnatomyDistance.of(scenario)
        return None if distance is None else cls(distance)

    def __call__(self, shape: Shape) -> None:
        """Looks at the stations of the innermost tube, with the radius of what is around it."""
        ahead = shape.s_m >= 0
        if ahead.any():
            owner = np.zeros(int(ahead.sum()), dtype=np.intp)
            found = self.distance.least(shape.centreline_m[ahead], shape.radius_m[ahead], owner, 1)
            self.clearances_m.append(float(found[0]))

    @property
    def sentence(self) -> str:
        """For the problems of a certificate; empty where all bodies keep clear, but for what meshes differ by."""
        deep = -min(self.clearances_m, default=np.inf) - BEYOND_BOUND_M
        if not deep > 0:
            return ""
        return f"A simulated robot comes {(deep + BEYOND_BOUND_M) * MM_PER_M:.2f} mm too close to the anatomy."
