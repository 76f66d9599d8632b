"""What planning produces: legs, the certificate that checked them, the trajectory that plays them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import Drive
from ctrplan.errors import InputError
from ctrplan.planning.search_clock import SearchEnd

if TYPE_CHECKING:
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.mechanics.core import Accuracy
    from ctrplan.planning.certificate.certify import Arrival
    from ctrplan.planning.certificate.recheck import Recheck
    from ctrplan.planning.scenario import Scenario

LegKind = Literal["rotation", "translation", "simultaneous"]
LONGEST_S, LARGEST_SEED = 3600.0, 2**31 - 10**5 - 1  # the search adds to the seed
ENDED_BY_TIME = "The search was ended by the clock: with the same seed, another machine may find another path."
MotionStyle = Literal["rotations before translations", "simultaneous"]


@dataclass(frozen=True, eq=False)
class Leg:
    """A straight motion in joint space, from rest to rest unless the next leg continues in its direction."""

    start: Array  # (m,) actuated joints, rad or m; unlimited rotations keep their winding
    end: Array  # (m,)
    kind: LegKind

    def sample(self, count: int) -> Array:
        """(count + 1, m) joint values at equal steps, both ends included."""
        share = np.linspace(0.0, 1.0, count + 1)[:, None]
        return self.start + share * (self.end - self.start)


@dataclass(frozen=True, eq=False)
class CertificateSamples:
    """The finished legs with the full model, K samples in the order driven."""

    leg: NDArray[np.int_]  # (K,) index of the leg
    joints: Array  # (K, m)
    path_mm: Array  # (K,) weighted joint length travelled
    bound_m: Array  # (K,) worst-case friction error of the tip
    bound_rad: Array  # (K,) of the tip tangent
    stability: Array  # (K,)
    max_strain: Array  # (K,)
    clearance_m: Array  # (K,) of every corner shape to the anatomy, beyond its margins; inf in free space
    motion_m: Array  # (K,) largest displacement of a body point of any shape since the sample before
    tip_m: Array  # (K, 3) frictionless tip, robot frame
    released_m: Array  # (K,) as bound_m, less what translations released by the friction law; fully loaded at the start
    predicted_m: Array  # (K,) friction error by simulated history, the largest over the states it may start in
    play_m: Array  # (K,) how far play of the drive may move the robot


@dataclass(frozen=True, eq=False)
class Settling:
    """The oscillation of decreasing amplitude that ends a plan (Section V-A of the paper)."""

    amplitude_rad: float  # of the first turn, between neighbouring tubes
    turns: Array  # (m,) joint motion per rad of amplitude
    first_leg: int  # index of its first leg; the rest of the plan is settling
    min_clearance_m: float  # while settling; inf in free space
    goal_predicted_before_m: float  # predicted error that it starts from
    goal_predicted_after_m: float  # and that it leaves


@dataclass(frozen=True)
class TargetReached:
    """A target of a plan, and how well it is reached there."""

    name: str
    leg: int  # index of the leg that ends at it
    path_mm: float  # weighted joint length travelled until then
    bound_m: float
    bound_rad: float
    released_m: float  # the bound less what the friction law says translations released
    predicted_m: float  # by simulated history
    tip_error_m: float  # frictionless tip to the target; 0 for joint goals
    play_m: float = 0.0  # how far play of the drive may move the tip
    line_error_m: float | None = (
        None  # largest distance of the frictionless tip from the line on the way, if it has one
    )


@dataclass(frozen=True, eq=False)
class CertifiedLegs:
    """Legs to one target as they were walked for a certificate: all that is needed to walk them again."""

    scenario: Scenario  # from where they start, with that target as its goal
    corners: Array  # (K, m) rad or m; one row where the target is reached already
    accuracy: Accuracy
    arrival: Arrival


@dataclass(frozen=True, eq=False)
class Certificate:
    """Dense recheck of the legs, independent of anything the search approximated."""

    samples: CertificateSamples
    valid: bool
    problems: tuple[str, ...]  # sentences; empty when valid
    worst_bound_m: float
    goal_bound_m: float
    goal_bound_rad: float
    goal_tip_error_m: float  # frictionless tip to the goal's tip; 0 for joint goals
    error_integral_mm: float  # integral of the bound over the joint length, mm * mm / mm_per_rad
    worst_predicted_m: float  # as the bounds, but by simulated history
    goal_predicted_m: float
    released_integral_mm: float  # integrals of released_m and predicted_m, like error_integral_mm
    predicted_integral_mm: float
    goal_predicted_tip_m: Array  # (3,) robot frame, mean over the start states
    goal_predicted_spread_m: float  # how far from it a start state can leave the tip
    snaps: int  # times a simulated robot slid to another equilibrium
    min_clearance_m: float  # after taking off half the largest motion between samples; inf in free space
    min_stability: float
    max_strain: float
    length_mm: float  # weighted joint length
    stops: int  # of the drive on the way: changes of direction, and targets but the last
    cost_mm: float
    spacing_m: float  # largest motion of a body point of any shape between samples
    worst_play_m: float = 0.0  # how far play of the drive may move the robot
    goal_play_m: float = 0.0
    targets: tuple[TargetReached, ...] = ()  # in the order reached, the goal last
    settling: Settling | None = None
    walked: tuple[CertifiedLegs, ...] = ()  # the legs to each target

    def recheck(self) -> Recheck:
        """Walks the legs again, on the mesh they were certified on and on the certificate mesh; see `Recheck`.

        Takes seconds. Raises InputError where the certificate does not hold its legs.
        """
        from ctrplan.planning.certificate.recheck import recheck_certificate

        return recheck_certificate(self)


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
class Plan:
    """A certified motion of the drive from a scenario's start to its goal."""

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

    @property
    def waypoints(self) -> Array:
        """(L + 1, m) joint values at the ends of the legs."""
        return np.array([self.legs[0].start, *(leg.end for leg in self.legs)])

    def recheck(self) -> Recheck:
        """`certificate.recheck()`, and whether legs and trajectory are the ones that the certificate walked."""
        from ctrplan.planning.certificate.recheck import recheck_plan

        return recheck_plan(self)

    def to_json(self) -> dict[str, Any]:
        """The content of plan.json, plain types only; the schema is in docs/plan.schema.json."""
        from ctrplan.planning.plan_json import plan_to_json

        return plan_to_json(self)


def leg_kind(drive: Drive, start: Array, end: Array) -> LegKind:
    """What moves between two joint vectors."""
    moved = start != end
    rotates, translates = bool(np.any(moved & drive.is_rotation)), bool(np.any(moved & ~drive.is_rotation))
    if rotates and translates:
        return "simultaneous"
    return "rotation" if rotates else "translation"


def checked_search(seed: int, time_s: float) -> float:
    """The time [s] for a search. Raises InputError unless seed and time can be used."""
    if not 0 < time_s <= LONGEST_S:
        raise InputError(f"must be above 0 and at most {LONGEST_S:g}", key="time_s", value=time_s, unit="s")
    if not (isinstance(seed, (int, np.integer)) and 0 <= seed <= LARGEST_SEED):
        raise InputError(f"must be a whole number from 0 to {LARGEST_SEED}", key="seed", value=seed)
    return float(time_s)
