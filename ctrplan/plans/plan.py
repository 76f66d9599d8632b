"""The plan: a planned motion that writes and rechecks itself. Its parts can be imported from here too."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ctrplan.certificate.certificate import Closest, Recheck, path_differences
from ctrplan.plans.plan_json import plan_to_json
from ctrplan.plans.planned_motion import PlannedMotion
from ctrplan.plans.timing import place_time_s

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

    def time_of(self, place: Closest) -> float:
        """When [s] the trajectory passes a place of the certificate: `plan.time_of(plan.certificate.closest)`."""
        return place_time_s(self, place)

    def save(self, folder: str | os.PathLike[str], formats: Sequence[str] = ("csv", "ros2")) -> Path:
        """Writes what `ctrplan plan` writes: plan.json, the trajectory in these formats, report.html and plan.png.

        All of them or none; the folder is made if need be, and returned. Raises CtrplanError where the system refuses.
        """
        writer = importlib.import_module("ctrplan.reports.plan_folder")  # by name: it knows plans, they don't know it
        written: Path = writer.save_plan(self, folder, formats)
        return written

    @classmethod
    def load(
        cls,
        folder: str | os.PathLike[str],
        scenario: str | os.PathLike[str] | None = None,
        overrides: Sequence[str] = (),
    ) -> Plan:
        """The plan that `save` or `ctrplan plan` wrote into a folder; arguments as those of `ctrplan.load_plan`.

        Its figures are those of plan.json; its trajectory is made anew and must be the one in trajectory.csv. Its
        certificate can't be rechecked: ask `ctrplan.verify`. Raises InputError for anything malformed, of another
        scenario or robot, or that does not belong together.
        """
        reader = importlib.import_module("ctrplan.files.plan_folder")  # by name: it knows plans, they don't know it
        found: Plan = reader.load_plan_folder(folder, scenario, overrides)
        return found

    def to_json(self) -> dict[str, Any]:
        """The content of plan.json, plain types only; the schema is in docs/plan.schema.json."""
        return plan_to_json(self)
