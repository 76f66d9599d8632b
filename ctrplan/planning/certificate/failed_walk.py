"""Why a walk was not certified, with the place where that is one: whoever changes the scenario has to find it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ctrplan.base.units import MM_PER_M
from ctrplan.planning.certificate.closest import closest_places
from ctrplan.planning.clearance_shares import TOO_CLOSE

if TYPE_CHECKING:
    from ctrplan.planning.certificate.walked_legs import WalkedLegs


def failure_with_place(walk: WalkedLegs) -> str:
    """The walk's failure; of a clearance also the part, and where the tube is (on its centreline, anatomy's frame)."""
    failure = walk.failure
    if TOO_CLOSE not in failure:
        return failure
    place = closest_places(walk.scenario, walk.pieces, walk.samples).certified
    if place is None:
        return failure
    at = ", ".join(f"{x:.1f}" for x in place.point_m * MM_PER_M)
    frame = f" in {walk.scenario.frame}" if walk.scenario.frame else ""
    return f"{failure.rstrip('.')}; there tube {place.tube} is at [{at}] mm{frame}, nearest to {place.part}."
