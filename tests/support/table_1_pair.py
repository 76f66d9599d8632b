"""The tube pair of Table I with any clearance, friction and straight transmission."""

from __future__ import annotations

from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.tube import Tube, TubeSection


def table_1_pair(clearance_m: float, mu: float, transmission_m: float = 0.017) -> Mechanics:
    """Two equally stiff tubes that each bend to a radius of 150 mm, the inner one of 1.0 mm outer diameter."""
    curved = (TubeSection(0.15, 0.0, 1 / 0.15),)
    straight = (TubeSection(transmission_m, 0.0, 0.0),) if transmission_m else ()
    bore = 1e-3 + 2 * clearance_m
    tubes = (Tube(bore + 2e-4, bore, 0.0507, 0.3, curved), Tube(1e-3, 8e-4, 0.0507, 0.3, straight + curved))
    return Mechanics(tubes, [clearance_m], [mu])
