"""A plan under judgement: its way, its claims, what a state of the robot on the way says about them, and the worst
of these.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ctrplan.audit.body import BodyPoints, RawAnatomy, body_of
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.certificate.certificate import FIGURES
from ctrplan.errors import CtrplanError
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.mechanics.shapes import Accuracy, Shape, Status
from ctrplan.robot.robot import Robot

MM_PER_RAD = 20.0  # of the length by which places are counted; it changes no claim


@dataclass(frozen=True, eq=False)
class DrivenWay:
    """R rows of joints, straight in between; a place is a share from 0 to 1 of the length travelled."""

    joints: Array  # (R, m)
    leg: Array  # (R,) legs driven until there, and the share of the next
    time_s: Array  # (R,)
    place: Array  # (R,)

    @classmethod
    def of(cls, plan: WrittenPlan) -> DrivenWay:
        """The way of a plan: trajectory and legs together."""
        corners = np.arange(len(plan.waypoints), dtype=np.float64)
        legs = np.concatenate([plan.places, corners])
        order = np.argsort(legs, kind="stable")
        joints = np.concatenate([plan.position, plan.waypoints])[order]
        times = np.concatenate([plan.time_s, np.interp(corners, plan.places, plan.time_s)])[order]
        is_rotation = plan.scenario.robot.drive.is_rotation
        steps = np.abs(np.diff(joints, axis=0)) * np.where(is_rotation, MM_PER_RAD, MM_PER_M)
        travelled = np.concatenate([[0.0], np.cumsum(steps.sum(axis=1))])
        return cls(joints, legs[order], times, travelled / max(travelled[-1], 1e-300))

    def joints_at(self, place: float) -> Array:
        """(m,) rad or m."""
        return np.array([np.interp(place, self.place, column) for column in self.joints.T])

    def leg_at(self, place: float) -> float:
        """Leg from 0, and the share of it."""
        return float(np.interp(place, self.place, self.leg))

    def time_at(self, place: float) -> float:
        """Seconds."""
        return float(np.interp(place, self.place, self.time_s))

    def places_of(self, legs: Array) -> Array:
        """(K,) places of legs and shares (K,)."""
        return np.interp(legs, self.leg, self.place)

    def until(self, place: float) -> Array:
        """(K, m) corners of the way from its start to a place, both included."""
        passed = self.leg_at(place)
        corners = [self.joints_at(float(self.places_of(np.array([k]))[0])) for k in range(int(np.ceil(passed)))]
        return np.array([*corners, self.joints_at(place)])


# By how much a figure may miss its claim, and what share of the claim comes on top: rounding, or what the meshes of
# certificate and judge differ by. Clearances and worst bounds are claimed with an allowance for that.
ALLOWED = {
    "clearance": 0.01e-3,
    "worst bound": 0.01e-3,
    "bound": 0.3e-3,
    "predicted": 0.3e-3,
    "stability": 0.01,
    "strain": 0.2e-3,
}
SHARE = {"clearance": 0.0, "worst bound": 0.0, "bound": 0.02, "predicted": 0.02, "stability": 0.02, "strain": 0.02}
SMALLER_IS_WORSE = [figure.claim for figure in FIGURES.values() if figure.is_minimum]


@dataclass(frozen=True, eq=False)
class WorstFigure:
    """A figure of a claim at a place of the way; SI."""

    claim: str  # a key of ALLOWED
    value: float
    stated: float  # what the certificate claims there; NaN where it claims nothing
    place: float
    joints: Array  # (m,)
    leg: int  # from 1
    time_s: float
    point_m: Array  # (3,) anatomy's frame: where the clearance is least, else the tip
    tube: int  # from 1
    phi: tuple[float, ...]  # uniform friction state; of a history where it started
    before: Array | None = None  # (H, m) joints driven before the start, for a state that a history leads to
    play: tuple[float, ...] = ()  # share of the play of every collar, rotations first
    accuracy: Accuracy = "certificate"

    @property
    def excess(self) -> float:
        """By how much the figure is worse than claimed; negative: better."""
        return self.stated - self.value if self.claim in SMALLER_IS_WORSE else self.value - self.stated

    @property
    def is_broken(self) -> bool:
        """Whether the claim is broken, beyond what is allowed for rounding and meshes."""
        return self.excess > ALLOWED[self.claim] + SHARE[self.claim] * abs(self.stated)

    def worse_than(self, other: WorstFigure | None) -> bool:
        """Whether it says more against its claim."""
        if other is None:
            return True
        if self.stated != self.stated:  # nothing is claimed
            return self.value < other.value if self.claim in SMALLER_IS_WORSE else self.value > other.value
        return self.excess > other.excess

    @property
    def how(self) -> str:
        """The friction state in words."""
        state = ", ".join(f"{phi:+.3g}" for phi in self.phi)
        if self.before is None:
            return f"friction state ({state})"
        began = f"({state})" if any(self.phi) else "released"
        return f"a simulated history, {began}, {len(self.before)} turns before the start"

    @property
    def where(self) -> str:
        """Leg, time, place and tube in words."""
        point = ", ".join(f"{x:.1f}" for x in self.point_m * MM_PER_M)
        return f"leg {self.leg}, {self.time_s:.2f} s, tube {self.tube} at ({point}) mm"


WHOLE_WAY = {figure.claim: key for key, figure in FIGURES.items() if figure.claim}  # and its key in plan.json
COST: dict[Accuracy, int] = {"search": 15, "certificate": 30, "exact": 80}  # of a solve, in units of 0.1 ms or so


@dataclass(eq=False)
class AuditedPlan:
    """A plan under judgement; counts the work that is spent on it."""

    plan: WrittenPlan
    robot: Robot
    way: DrivenWay
    anatomy: RawAnatomy
    accuracy: Accuracy
    worst: dict[str, WorstFigure] = field(default_factory=dict)  # of every claim
    work: int = 0

    @classmethod
    def of(cls, plan: WrittenPlan, accuracy: Accuracy) -> AuditedPlan:
        """The case of a written plan; figures are those of meshes of `accuracy`."""
        scenario = plan.scenario
        return cls(plan, scenario.robot, DrivenWay.of(plan), RawAnatomy.of(scenario.anatomy), accuracy)

    def __post_init__(self) -> None:
        """Where the certificate's samples lie, and what it claims there."""
        self.sample_place = self.way.places_of(self.plan.certified_places)
        self.bound_m, self.predicted_m = self.plan.column("bound_m"), self.plan.column("predicted_m")

    @property
    def pairs(self) -> int:
        """Number of pairs of neighbouring tubes."""
        return self.robot.n - 1

    def stated(self, claim: str, place: float) -> float:
        """What the certificate claims at a place: of the samples on both sides the laxer one, or for the whole way."""
        if claim in ("bound", "predicted"):
            after = min(int(np.searchsorted(self.sample_place, place)), len(self.sample_place) - 1)
            column = self.bound_m if claim == "bound" else self.predicted_m
            return float(np.nanmax([column[max(after - 1, 0)], column[after], np.nan_to_num(column[after])]))
        value = self.plan.certificate[WHOLE_WAY[claim]]
        return np.nan if value is None else float(value)

    def collars(self, place: float, play: tuple[float, ...] = ()) -> tuple[Array, Array]:
        """(n,) [rad], (n,) [m] that the drive holds at a place, moved within its play."""
        theta_b, l_b = self.robot.drive.collars(self.way.joints_at(place))
        if not play or self.robot.drive.play is None:
            return theta_b, l_b
        n = self.robot.n
        return theta_b + self.robot.drive.play[0] * play[:n], l_b + self.robot.drive.play[1] * play[n:]

    def located(self, points_m: Array) -> Array:
        """(K, 3) of the robot's frame in the anatomy's."""
        return points_m @ self.plan.scenario.base_R.T + self.plan.scenario.base_position_m

    def room(self, body: BodyPoints) -> tuple[float, int, Array]:
        """Least clearance [m] of a body, the tube, and the point (3,) of its centreline in the anatomy's frame."""
        rooms = self.anatomy.room(self.located(body.point_m)) - body.radius_m
        k = int(np.argmin(rooms))
        if np.isfinite(rooms[k]):
            near = body.around(k)
            finer = self.anatomy.room(self.located(near.point_m)) - near.radius_m
            j = int(np.argmin(finer))
            if finer[j] < rooms[k]:
                return float(finer[j]), int(body.tube[k]), self.located(near.point_m[j : j + 1])[0]
        return float(rooms[k]), int(body.tube[k]), self.located(body.point_m[k : k + 1])[0]

    def solved(
        self, place: float, phi: tuple[float, ...], play: tuple[float, ...] = (), accuracy: Accuracy | None = None
    ) -> list[WorstFigure]:
        """Findings of one state in the cube of friction, and of the frictionless one; empty where unsolved."""
        mesh = accuracy or self.accuracy
        self.work += 2 * COST[mesh]
        try:
            collars = self.collars(place, play)
            states = np.array([np.zeros(self.pairs), phi])
            free, shape = (self.robot.solve(*collars, state, accuracy=mesh) for state in states)
            bodies = self.robot.mechanics.friction_bodies(*collars, states, spacing_m=5e-3, accuracy=mesh)
        except CtrplanError:
            return []
        if max(free.status, shape.status) >= Status.FAILED:
            return []
        result = self.of_shape(shape, None if play else free.tip_m, place, phi, play=play)
        for state, solved, stability in zip(states, (free, shape), bodies.stability, strict=True):
            result.append(self.finding("stability", float(stability), place, tuple(state), solved, play=play))
        return [replace(f, accuracy=mesh) for f in result]

    def of_shape(
        self,
        shape: Shape,
        free_tip_m: Array | None,
        place: float,
        phi: tuple[float, ...],
        *,
        before: Array | None = None,
        play: tuple[float, ...] = (),
    ) -> list[WorstFigure]:
        """Clearance, strain, and deviation from the frictionless tip (3,) of a solved shape."""
        results = [self.finding("strain", float(shape.max_strain), place, phi, shape, before=before, play=play)]
        if self.plan.scenario.anatomy:
            room, tube, point = self.room(body_of(self.robot, shape))
            least = self.finding("clearance", room, place, phi, shape, before=before, play=play)
            results.append(replace(least, tube=tube, point_m=point))
        if free_tip_m is not None:
            off = float(np.linalg.norm(shape.tip_m - free_tip_m))
            results += [
                self.finding(claim, off, place, phi, shape, before=before) for claim in ("bound", "worst bound")
            ]
        return results

    def finding(
        self,
        claim: str,
        value: float,
        place: float,
        phi: tuple[float, ...],
        shape: Shape | Array,
        *,
        before: Array | None = None,
        play: tuple[float, ...] = (),
    ) -> WorstFigure:
        """A figure at a place; its point is the tip of the shape, or the tip (3,) itself."""
        tip = shape if isinstance(shape, np.ndarray) else shape.tip_m
        leg = min(int(self.way.leg_at(place)) + 1, len(self.plan.waypoints) - 1)
        return WorstFigure(
            claim=claim,
            value=value,
            stated=self.stated(claim, place),
            place=place,
            joints=self.way.joints_at(place),
            leg=leg,
            time_s=self.way.time_at(place),
            point_m=self.located(tip[None])[0],
            tube=self.robot.n,
            phi=tuple(float(x) for x in phi),
            before=before,
            play=play,
            accuracy=self.accuracy,
        )

    def note(self, findings: list[WorstFigure]) -> None:
        """Keeps of every claim what says most against it."""
        for result in findings:
            if np.isfinite(result.value) and result.worse_than(self.worst.get(result.claim)):
                self.worst[result.claim] = result
