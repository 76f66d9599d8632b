"""How likely a motion misses one of its targets: every drawn robot is judged at all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.planning.target_chances.target_miss import Judged, StopJudged
from ctrplan.planning.uncertainty.chance import Chance, chance
from ctrplan.planning.uncertainty.goal_miss import TourMiss


def tour_miss(found: Sequence[StopJudged]) -> TourMiss | None:
    """None of less than two targets that can be missed."""
    found = [stop for stop in found if stop.aim.tolerance_m is not None]
    if len(found) < 2:
        return None
    histories = [(stop, stop.by_history) for stop in found if stop.by_history is not None]
    return TourMiss(
        targets=len(found),
        chance_any_friction=_any_missed([(stop, stop.any_friction) for stop in found]),
        chance_by_history=_any_missed(histories) if len(histories) == len(found) else None,
    )


def _any_missed(found: Sequence[tuple[StopJudged, Judged]]) -> Chance:
    missed = [judged.missed(stop.aim) for stop, judged in found]
    return chance(*(np.any(events, axis=0) for events in zip(*missed, strict=True)))
