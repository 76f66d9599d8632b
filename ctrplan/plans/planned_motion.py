"""Planned motions: legs, the certificate that checked them, the trajectory that plays them, and when it passes which
place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import SearchEnd
from ctrplan.base.package import shown
from ctrplan.certificate.certificate import Certificate
from ctrplan.drive.drive import Drive
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.mechanics.shapes import Status
from ctrplan.scenario.joint_space import MotionStyle

if TYPE_CHECKING:
    from ctrplan.certificate.certificate import Closest
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.uncertainty.result import Uncertainty

LegKind = Literal["rotation", "translation", "simultaneous"]


@shown
@dataclass(frozen=True, eq=False)
class Leg:
    """A straight motion in joint space, from rest to rest unless the next leg continues in its direction."""

    start: Array  # (m,) actuated joints, rad or m; unlimited rotations keep their winding
    end: Array  # (m,)
    kind: LegKind


@shown
@dataclass(frozen=True, eq=False)
class Compensation:
    """Joints commanded so that the predicted tip arrives, not the frictionless one."""

    correction: Array  # (m,) rad or m, added to the last legs; zero where nothing could be gained
    error_without_m: float  # largest distance of a predicted tip from the goal's, over the start states
    error_with_m: float
    note: str  # what is left of the known offset, and why; empty if nothing is


@dataclass(frozen=True)
class ComparedWay:
    """A way from the same start to the same goal, for comparison."""

    name: str  # "as given", "as driven", "straight line", "translations first"
    goal_predicted_m: float  # predicted friction error at the goal; inf where no history leads there
    length_mm: float
    problem: str  # why it must not be driven; empty if it may
    terms_mm: Mapping[str, float] = field(default_factory=dict)  # what terms of the user's own cost, by name


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
    compare: Callable[[], tuple[ComparedWay, ...]] = tuple  # simulates the alternatives
    terms_before_mm: Mapping[str, float] = field(default_factory=dict)  # what terms of the user's own cost, by name
    terms_after_mm: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def alternatives(self) -> tuple[ComparedWay, ...]:
        """Other ways to the goal from the target before, or the start; simulated when they are first looked at."""
        return self.compare()

    @property
    def known_alternatives(self) -> tuple[ComparedWay, ...]:
        """The alternatives if they were looked at, else none: what a file has of them."""
        return self.alternatives if "alternatives" in vars(self) else ()


@shown
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
    clock_s: float  # that planning took by the clock
    first_found_s: float  # of them, until the first path was found
    first_certified_s: float  # until the first path passed its certificate
    work_s: float | None = None  # of searching, counted, so that it is the same anywhere; None where nothing counted
    notes: tuple[str, ...] = field(default=())
    compensation: Compensation | None = None  # only if asked for
    interrupted: bool = False  # by Ctrl-C: the best path found until then
    ended_by: SearchEnd = "completion"  # what ended the search; "completion": it had nothing left to do
    follow_the_leader_m: float | None = (
        None  # largest distance of the inserting body from its tip's track, frictionless
    )
    uncertainty: Uncertainty | None = None  # None where nothing is stated to be uncertain
    clock_s_by: Mapping[str, float] = field(default_factory=dict)  # what took how much of `clock_s`, in its order

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


class Played(Protocol):
    """Samples of a motion over time: a trajectory, or what was read of one."""

    @property
    def time_s(self) -> Array:
        """(T,) rising from 0."""

    @property
    def position(self) -> Array:
        """(T, m) rad or m."""


def sample_time_s(plan: PlannedMotion) -> Array:
    """(K,) [s] when the trajectory passes the samples of the certificate."""
    return _time_at(plan, _travelled(plan, plan.certificate.samples.joints))


def place_time_s(plan: PlannedMotion, place: Closest) -> float:
    """When [s] the trajectory passes a place of closest approach."""
    return float(np.interp(place.path_mm, plan.certificate.samples.path_mm, sample_time_s(plan)))


def leg_end_s(plan: PlannedMotion) -> Array:
    """(L,) [s] when each leg ends; legs that continue in one direction are passed without rest."""
    if len(plan.trajectory.leg_end_s) == len(plan.legs):
        return plan.trajectory.leg_end_s
    return _time_at(plan, _travelled(plan, plan.waypoints)[1:])


def restarts(certificate: Certificate) -> tuple[int | None, ...]:
    """Waypoints from which a run that was interrupted on its way to each target begins again, as of `Arrival.restart`.

    Whoever begins again at that of a later target leaves out the targets before it.
    """
    arrivals = [*(target.arrival for target in certificate.targets[:-1]), certificate.arrival]
    return tuple(None if arrival is None else arrival.restart for arrival in arrivals)


def marked_trajectory(plan: PlannedMotion) -> Trajectory:
    """The trajectory with the leg of each sample, from 1, whether a pair of tubes forgets its friction on that leg, and
    the sample from which an interrupted run begins again, of a tour one for each target.
    """
    trajectory, arrival, ends = plan.trajectory, plan.certificate.arrival, leg_end_s(plan)
    leg = np.minimum(np.searchsorted(ends, trajectory.time_s - BETWEEN_SAMPLES_S), len(ends) - 1)
    erasing = [pair.leg for pair in arrival.erased if pair.leg is not None] if arrival else []
    restart = np.zeros(len(leg), dtype=np.int_)
    for waypoint in restarts(plan.certificate):
        if waypoint is not None:
            begins_s = ends[waypoint - 1] if waypoint else 0.0
            restart[int(np.searchsorted(trajectory.time_s, begins_s - BETWEEN_SAMPLES_S))] = 1
    return replace(
        trajectory, marks={"leg": leg + 1, "erases": np.isin(leg, erasing).astype(np.int_), "restart": restart}
    )


def settling_duration_s(plan: PlannedMotion) -> float:
    """How long [s] the oscillation takes that ends the plan; 0 without one."""
    settling = plan.certificate.settling
    if settling is None:
        return 0.0
    before = leg_end_s(plan)[settling.first_leg - 1] if settling.first_leg else 0.0
    return float(plan.trajectory.duration_s - before)


def joints_at(trajectory: Played, time_s: Array) -> Array:
    """(T, m) joint values [rad, m] of the trajectory at time_s (T,) [s], linear between its samples."""
    return np.stack([np.interp(time_s, trajectory.time_s, column) for column in trajectory.position.T], axis=1)


def _time_at(plan: PlannedMotion, travelled_mm: Array) -> Array:
    return np.interp(travelled_mm, _travelled(plan, plan.trajectory.position), plan.trajectory.time_s)


def _travelled(plan: PlannedMotion, joints: Array) -> Array:
    """(K,) length [mm] of the polyline through joints (K, m), 1 rad counted as the scenario's mm_per_rad."""
    scale = np.where(plan.scenario.robot.drive.is_rotation, plan.scenario.cost.mm_per_rad, 1e3)
    steps = np.linalg.norm(np.diff(joints * scale, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


BETWEEN_SAMPLES_S = 1e-9  # by which instants may differ that are one
POSES = 60
LEAST_SHARE = 0.4  # of the body's length in front of the plate at the end that came out on the way: else no insertion


def follow_the_leader_m(robot: Robot, trajectory: Trajectory) -> float | None:
    """Largest distance of the body without friction from the track of its tip so far and its shape at the start [m].

    None where the robot does not insert itself, or a pose has no solution. Solves POSES times: asked for once, when a
    plan is made, and kept in it.
    """
    bodies = _bodies(robot, trajectory)
    if bodies is None or _length(bodies[0]) > (1 - LEAST_SHARE) * _length(bodies[-1]):
        return None
    track, worst = bodies[0], 0.0
    for body in bodies[1:]:
        track = np.concatenate([track, body[-1:]])
        worst = max(worst, float(distance_from_polyline(body, track).max()))
    return worst


def _bodies(robot: Robot, trajectory: Trajectory) -> list[Array] | None:
    """Frictionless centrelines (N, 3) in front of the plate, from the plate to the tip."""
    results = []
    for joints in joints_at(trajectory, np.linspace(0.0, trajectory.duration_s, POSES)):
        shape = robot.mechanics.solve(*robot.drive.collars(joints))
        if shape.status >= Status.FAILED:
            return None
        ahead = shape.centreline_m[shape.s_m >= 0]
        results.append(ahead if len(ahead) > 1 else np.zeros((2, 3)))
    return results


def _length(line: Array) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
