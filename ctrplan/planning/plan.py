"""The plan: a planned motion that writes and rechecks itself. Its parts can be imported from here too."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ctrplan.errors import InputError
from ctrplan.planning.certified import Certificate, CertificateSamples, Recheck, Settling, TargetReached
from ctrplan.planning.comparison import path_differences
from ctrplan.planning.plan_json import plan_to_json
from ctrplan.planning.planned_motion import (
    ComparedWay,
    Compensation,
    Leg,
    LegKind,
    MotionStyle,
    PlannedMotion,
    ReorderReport,
    leg_kind,
)

__all__ = [
    "Certificate",
    "CertificateSamples",
    "ComparedWay",
    "Compensation",
    "Leg",
    "LegKind",
    "MotionStyle",
    "Plan",
    "Recheck",
    "ReorderReport",
    "Settling",
    "TargetReached",
    "checked_search",
    "leg_kind",
]

LONGEST_S, LARGEST_SEED = 3600.0, 2**31 - 10**5 - 1  # the search adds to the seed
ENDED_BY_TIME = "The search was ended by the clock: with the same seed, another machine may find another path."


@dataclass(frozen=True, eq=False)
class Plan(PlannedMotion):
    """A certified motion of the drive from a scenario's start to its goal."""

    def recheck(self) -> Recheck:
        """`certificate.recheck()`, and whether legs and trajectory are the ones that the certificate walked.

        Takes seconds. Raises InputError where the certificate does not know its legs.
        """
        found = self.certificate.recheck()
        apart = path_differences(self.waypoints, self.trajectory.position, found.fresh.samples.joints)
        return replace(found, differences=(*apart, *found.differences))

    def to_json(self) -> dict[str, Any]:
        """The content of plan.json, plain types only; the schema is in docs/plan.schema.json."""
        return plan_to_json(self)


def checked_search(seed: int, time_s: float) -> float:
    """The time [s] for a search. Raises InputError unless seed and time can be used."""
    if not 0 < time_s <= LONGEST_S:
        raise InputError(f"must be above 0 and at most {LONGEST_S:g}", key="time_s", value=time_s, unit="s")
    if not (isinstance(seed, (int, np.integer)) and 0 <= seed <= LARGEST_SEED):
        raise InputError(f"must be a whole number from 0 to {LARGEST_SEED}", key="seed", value=seed)
    return float(time_s)
