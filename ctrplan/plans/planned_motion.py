"""What planning finds: legs, the certificate that checked them, the trajectory that plays them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import SearchEnd
from ctrplan.certificate.certificate import Certificate
from ctrplan.drive.drive import Drive
from ctrplan.scenario.joint_space import MotionStyle

if TYPE_CHECKING:
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.uncertainty.result import Uncertainty

LegKind = Literal["rotation", "translation", "simultaneous"]


@dataclass(frozen=True, eq=False)
class Leg:
    """A straight motion in joint space, from rest to rest unless the next leg continues in its direction."""

    start: Array  # (m,) actuated joints, rad or m; unlimited rotations keep their winding
    end: Array  # (m,)
    kind: LegKind


@dataclass(frozen=True, eq=False)
class Compensation:
    """Joints commanded so that the predicted tip arrives, not the frictionless one."""

    correction: Array  # (m,) rad or m, added to the last legs; zero where nothing could be gained
    error_without_m: float  # largest distance of a predicted tip from the goal's, over the start states
    error_with_m: float
    note: str  # why there is no correction; empty if there is


@dataclass(frozen=True)
class ComparedWay:
    """A way from the same start to the same goal, for comparison."""

    name: str  # "as given", "as driven", "straight line", "translations first"
    goal_predicted_m: float  # predicted friction error at the goal; inf where no history leads there
    length_mm: float
    problem: str  # why it must not be driven; empty if it may


@dataclass(frozen=True, eq=False)
class ReorderReport:
    """What reordering changed: the same figures before and after; errors are those of the friction law."""

    cost_before_mm: float
    cost_after_mm: float
    goal_bound_before_m: float
    goal_bound_after_m: float
    error_integral_before_mm: float
    error_integral_after_mm: float
    stops_before: int
    stops_after: int
    changes: tuple[str, ...] = ()  # sentences: what was reordered on the way to the goal
    alternatives: tuple[ComparedWay, ...] = ()  # other ways to it from the target before, or the start


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """What was found about a motion from a scenario's start to its goal; `Plan` adds what can be made of it."""

    scenario: Scenario
    seed: int
    planner: str
    style: MotionStyle
    legs: tuple[Leg, ...]
    certificate: Certificate
    trajectory: Trajectory
    reorder: ReorderReport
    search_time_s: float
    first_found_s: float  # time to the first path found
    first_certified_s: float  # time to the first path that passed its certificate
    notes: tuple[str, ...] = field(default=())
    compensation: Compensation | None = None  # only if asked for
    interrupted: bool = False  # by Ctrl-C: the best path found until then
    ended_by: SearchEnd = "completion"  # what ended the search; "completion": it had nothing left to do
    follow_the_leader_m: float | None = (
        None  # largest distance of the inserting body from its tip's track, frictionless
    )
    uncertainty: Uncertainty | None = None  # None where nothing is stated to be uncertain

    @property
    def waypoints(self) -> Array:
        """(L + 1, m) joint values at the ends of the legs."""
        return np.array([self.legs[0].start, *(leg.end for leg in self.legs)])


def leg_kind(drive: Drive, start: Array, end: Array) -> LegKind:
    """What moves between two joint vectors."""
    moved = start != end
    rotates, translates = bool(np.any(moved & drive.is_rotation)), bool(np.any(moved & ~drive.is_rotation))
    if rotates and translates:
        return "simultaneous"
    return "rotation" if rotates else "translation"
