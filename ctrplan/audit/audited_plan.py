"""A plan under judgement: its way as the drive follows it in time, its claims, what a state of the robot on the way
says about them, and the worst of these.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ctrplan.audit.allowed_robots import EVEN, STANDING, AllowedRobots, BaseMove, nearest_base
from ctrplan.audit.body import BodyPoints, RawAnatomy, body_of
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.certificate.certificate import FIGURES
from ctrplan.drive.legs import Collars
from ctrplan.errors import CtrplanError
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.mechanics.shapes import Accuracy, Shape, Status
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import MM_PER_RAD

LATE_MM_PER_S = 1.0  # likewise, of time in which drives may rest


@dataclass(frozen=True, eq=False)
class DrivenWay:
    """R rows of time, straight in between; a place is a share from 0 to 1 of the length that the collars travel.

    It ends when the last drive has come to rest.
    """

    robots: AllowedRobots
    joints: Array  # (R, m)
    leg: Array  # (R,) legs driven until there, and the share of the next
    time_s: Array  # (R,)
    place: Array  # (R,)

    @classmethod
    def of(cls, plan: WrittenPlan, robots: AllowedRobots | None = None) -> DrivenWay:
        """The way of a plan: trajectory and legs together, and what follows late."""
        allowed = robots or AllowedRobots.of(plan.scenario.robot)
        corners = np.arange(len(plan.waypoints), dtype=np.float64)
        legs = np.concatenate([plan.places, corners])
        order = np.argsort(legs, kind="stable")
        joints = np.concatenate([plan.position, plan.waypoints])[order]
        times = np.concatenate([plan.time_s, np.interp(corners, plan.places, plan.time_s)])[order]
        legs = legs[order]
        if allowed.latest_s > 0:
            delays = np.unique(allowed.delays_s(np.zeros(allowed.count)))
            late = np.unique(
                np.concatenate([times, *(times + delay for delay in delays), times[-1:] + allowed.latest_s])
            )
            joints = np.column_stack([np.interp(late, times, column) for column in joints.T])
            legs, times = np.interp(late, times, legs), late
        way = cls(allowed, joints, legs, times, np.zeros(len(times)))
        commanded = way.commanded(times, np.zeros(allowed.count))
        weights = np.repeat([MM_PER_RAD, MM_PER_M], plan.scenario.robot.n)
        steps = (np.abs(np.diff(commanded, axis=0)) * weights).sum(axis=1)
        if allowed.latest_s > 0:  # drives whose delay is uncertain move while the others rest
            steps += LATE_MM_PER_S * np.diff(times)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        return cls(allowed, joints, legs, times, travelled / max(travelled[-1], 1e-300))

    def commanded(self, time_s: Array, axes: Array) -> Array:
        """(K, 2 n) where rotations [rad], then translations [m], are told to be at times (K,), as late as they follow.

        axes (A,) of the allowed robots.
        """
        delays = self.robots.delays_s(axes)
        columns = zip(delays, self._table.T, strict=True)
        return np.column_stack([np.interp(time_s - delay, self.time_s, column) for delay, column in columns])

    @cached_property
    def _table(self) -> Array:
        """(R, 2 n) what is commanded at the rows."""
        return np.hstack(self.robots.robot.drive.commanded(self.joints))

    def commanded_at(self, place: float, axes: Array) -> tuple[Array, Array]:
        """(n,) [rad], (n,) [m] at a place."""
        row = self.commanded(np.array([self.time_at(place)]), axes)[0]
        return row[: self.robots.robot.n], row[self.robots.robot.n :]

    def joints_at(self, place: float) -> Array:
        """(m,) rad or m, as they are commanded."""
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

    def bent(self, places: Array) -> list[float]:
        """Where effects of the drive take collars off the chord between two of the places (P,): the farthest rows."""
        axes, n = np.zeros(self.robots.count), self.robots.robot.n
        told = self.commanded(self.time_s, axes)
        stands = self.robots.driven(axes, Collars(told[:, :n], told[:, n:]))
        added = (np.hstack([stands.theta, stands.l]) - told) * np.repeat([MM_PER_RAD, MM_PER_M], n)
        chords = np.array([np.interp(self.place, places, np.interp(places, self.place, c)) for c in added.T]).T
        off, between = np.abs(added - chords).max(axis=1), np.searchsorted(places, self.place)
        rows = [own[np.argmax(off[own])] for k in np.unique(between) if len(own := np.flatnonzero(between == k))]
        return [float(self.place[row]) for row in rows if off[row] > EVEN]

    def until(self, place: float) -> Array:
        """(K, 2 n) where the collars are told to be on the way from its start to a place, both included."""
        places = self.places_of(np.arange(int(np.ceil(self.leg_at(place))), dtype=np.float64))
        times = np.interp([*places[places < place], place], self.place, self.time_s)
        if self.robots.latest_s > 0:
            times = np.append(self.time_s[self.time_s < times[-1]], times[-1])
        return self.commanded(times, np.zeros(self.robots.count))


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
    began: str = ""  # how friction at the start of a history came about, where `phi` does not say it
    play: tuple[float, ...] = ()  # share of the play of every collar, rotations first
    axes: tuple[float, ...] = ()  # of the allowed robots, where it is not the file's
    parameters: str = ""  # those that differ from the file's, with their values
    base: BaseMove = STANDING
    accuracy: Accuracy = "certificate"

    @property
    def excess(self) -> float:
        """By how much the figure is worse than claimed; negative: better."""
        return self.stated - self.value if self.claim in SMALLER_IS_WORSE else self.value - self.stated

    @property
    def allowance(self) -> float:
        """By how much the figure may miss its claim, for rounding and meshes."""
        return ALLOWED[self.claim] + SHARE[self.claim] * abs(self.stated)

    @property
    def is_broken(self) -> bool:
        """Whether the claim is broken, beyond the allowance."""
        return self.excess > self.allowance

    def worse_than(self, other: WorstFigure | None) -> bool:
        """Whether it says more against its claim."""
        if other is None:
            return True
        if self.stated != self.stated:  # nothing is claimed
            return self.value < other.value if self.claim in SMALLER_IS_WORSE else self.value > other.value
        return self.excess > other.excess

    @property
    def how(self) -> str:
        """The friction state, and what else was taken, in words."""
        state = ", ".join(f"{phi:+.3g}" for phi in self.phi)
        if self.before is not None:
            began = self.began or (f"({state})" if any(self.phi) else "released")
            return f"a simulated history, {began}, {len(self.before)} turns before the start{self._allowed}"
        return f"friction state ({state}){self._allowed}"

    @property
    def _allowed(self) -> str:
        """What else the scenario allows was taken, in words."""
        words = [self.parameters] if self.parameters else []
        words += ["play taken up"] if any(self.play) else []
        words += ["the base within its registration"] if self.base != STANDING else []
        return f"; {', '.join(words)}" if words else ""

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
    robots: AllowedRobots
    accuracy: Accuracy
    worst: dict[str, WorstFigure] = field(default_factory=dict)  # of every claim
    beside: dict[str, WorstFigure] = field(default_factory=dict)  # of other parameters than the file's, not claimed
    work: int = 0

    @classmethod
    def of(cls, plan: WrittenPlan, accuracy: Accuracy) -> AuditedPlan:
        """The case of a written plan; figures are those of meshes of `accuracy`."""
        robots = AllowedRobots.of(plan.scenario.robot)
        way, anatomy = DrivenWay.of(plan, robots), RawAnatomy.of(plan.scenario.anatomy)
        return cls(plan, robots.robot, way, anatomy, robots, accuracy)

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

    @property
    def middle(self) -> Array:
        """(A,) axes of the file's robot."""
        return np.zeros(self.robots.count)

    def collars(self, place: float, axes: Array | None = None) -> tuple[Array, Array]:
        """(n,) [rad], (n,) [m] that the drive holds at a place, on axes (A,) of the allowed robots.

        Raises CtrplanError where there is no such robot.
        """
        held = self._held(place, self.middle if axes is None else axes)
        return held.theta[0], held.l[0]

    def stands(self, points_m: Array, place: float, axes: Array | None = None) -> list[tuple[Array, float]]:
        """Points (..., 3) of the robot's frame at a place, as they are solved; and turned with the front plate, with
        what claims allow for that [m] besides.
        """
        at = self.middle if axes is None else axes
        if not self.robots.has_plate:
            return [(points_m, 0.0)]
        turned = self.robots.turned(at, self._held(place, at), points_m)
        return [(points_m, 0.0), (turned, self.robots.plate_margin_m)]

    def _held(self, place: float, axes: Array) -> Collars:
        """One row of `collars`."""
        self.robot_at(axes)
        return self.robots.driven(axes, Collars(*(part[None] for part in self.way.commanded_at(place, axes))))

    def robot_at(self, axes: Array) -> Robot:
        """The robot on axes (A,). Raises CtrplanError where there is none."""
        robot = self.robots.at(axes)
        if robot is None:
            raise CtrplanError("there is no robot with these parameters")
        return robot

    def count_points(self, count: int) -> None:
        """Counts the work of the distances of points."""
        self.work += -(-count * self.anatomy.work // 100)

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

    def nearest(self, body: BodyPoints) -> tuple[float, int, Array, BaseMove]:
        """Least clearance [m] of a body with the base where its registration brings it nearest; as `room`, and where
        the base is then.
        """
        room, tube, point = self.room(body)
        scenario = self.plan.scenario
        if scenario.registration.is_exact or not np.isfinite(room):
            return room, tube, point, STANDING
        places = self.located(body.point_m)
        rooms = self.anatomy.room(places) - body.radius_m
        move = nearest_base(scenario.registration, self.anatomy, places, rooms, scenario.base_position_m)
        moved = move.of(places, scenario.base_position_m)
        there = self.anatomy.room(moved) - body.radius_m
        k = int(np.argmin(there))
        return (
            (float(there[k]), int(body.tube[k]), moved[k], move) if there[k] < room else (room, tube, point, STANDING)
        )

    def solved(self, place: float, phi: tuple[float, ...], axes: Array | None = None) -> list[WorstFigure]:
        """Findings of one state in the cube of friction, and of the frictionless one; empty where unsolved.

        On axes (A,) of the allowed robots besides play, clearance alone: no other claim covers them.
        """
        at = self.middle if axes is None else axes
        self.work += 2 * COST[self.accuracy]
        try:
            collars, robot = self.collars(place, at), self.robot_at(at)
            states = np.array([np.zeros(self.pairs), phi])
            free, shape = (robot.solve(*collars, state, accuracy=self.accuracy) for state in states)
            bodies = robot.mechanics.friction_bodies(*collars, states, spacing_m=5e-3, accuracy=self.accuracy)
        except CtrplanError:
            return []
        if max(free.status, shape.status) >= Status.FAILED:
            return []
        result = self.of_shape(shape, None if np.any(at) else free.tip_m, place, phi, axes=at)
        for state, solved, stability in zip(states, (free, shape), bodies.stability, strict=True):
            result.append(self.finding("stability", float(stability), place, tuple(state), solved, axes=at))
        return [replace(f, accuracy=self.accuracy) for f in result]

    def of_shape(
        self,
        shape: Shape,
        free_tip_m: Array | None,
        place: float,
        phi: tuple[float, ...],
        *,
        before: Array | None = None,
        axes: Array | None = None,
    ) -> list[WorstFigure]:
        """Clearance, strain, and deviation from the frictionless tip (3,) of a solved shape."""
        results = [self.finding("strain", float(shape.max_strain), place, phi, shape, before=before, axes=axes)]
        if self.plan.scenario.anatomy:
            robot = self.robot if axes is None else self.robot_at(axes)
            body = body_of(robot, shape)
            stands = [
                (*self.nearest(replace(body, point_m=points)), margin_m)
                for points, margin_m in self.stands(body.point_m, place, axes)
            ]
            room, tube, point, base, margin_m = min(stands, key=lambda stand: stand[0] + stand[-1])
            least = self.finding("clearance", room + margin_m, place, phi, shape, before=before, axes=axes)
            results.append(replace(least, tube=tube, point_m=point, base=base))
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
        axes: Array | None = None,
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
            play=() if axes is None or not np.any(play := self.robots.play(axes)) else tuple(play.tolist()),
            axes=() if axes is None or not np.any(axes) else tuple(axes.tolist()),
            parameters="" if axes is None else self.robots.in_words(axes),
            accuracy=self.accuracy,
        )

    def note(self, findings: list[WorstFigure]) -> None:
        """Keeps of every claim what says most against it; beside, what other parameters do that no claim covers."""
        for result in findings:
            kept = self.beside if result.parameters and result.claim != "clearance" else self.worst
            if np.isfinite(result.value) and result.worse_than(kept.get(result.claim)):
                kept[result.claim] = result
