"""One motion, one call into the core: validity and cost of an edge, shared by whoever needs them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.anatomy.parts import exact_clearance_of_many
from ctrplan.base.arguments import Choice, Flag, Made, Number, Texts, checked
from ctrplan.base.arrays import MM_PER_M, Array, numbers, vector
from ctrplan.base.long_work import ASKED_NS, ROOM_NS, SHAPE_NS, SearchWatch, WorkMeter, cores, counted_aside
from ctrplan.errors import InputError
from ctrplan.mechanics.core import THREADS
from ctrplan.mechanics.friction import released_error
from ctrplan.mechanics.gradients import Clearances, clearances
from ctrplan.mechanics.walk import Field, KnownLegs, PathDensity, PathLimits, PathSamples
from ctrplan.motion.limits import SEARCH_ROOM_M, TOO_CLOSE, breach, clearance_between, search_limits
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.scenario.joint_space import JointSpace, MotionStyle, check_terms, terms_mm
from ctrplan.scenario.scenario import anatomy_grid, path_cost_mm

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

# Less room of zero-clearance shapes than this, and nothing is solved: none of 214 such in three scenarios was valid
DEFINITE_COLLISION_M = -1e-3
DOUBTFUL_M = 3e-3  # less room than that, and a motion is looked at where it has least, before it is walked
JUMP, JUMP_M = 3.0, 5e-3  # times the steps of the tip beside, and more than that and the translation by
FEW = 100  # shapes, which are not worth a thread
ASTRAY_M = 1e-3  # by which a local search may be too close on its way: corrections of as much are about linear
COEFFICIENTS = 0.3  # share by which a friction coefficient is mostly uncertain, a prior of the search
DEFINITE_COLLISION = "a corner shape comes too close to the anatomy: so does the zero-clearance shape"


@dataclass(frozen=True)
class Motion:
    """What a motion is worth; an invalid one has the reason and infinite cost."""

    valid: bool
    reason: str
    length_mm: float
    error_integral_mm: float  # integral of the error over the joint length, per mm_per_rad of length
    end_bound_m: float  # whatever the history
    left_m: Callable[[], float] = field(compare=False, repr=False)  # `end_error_m`, which is asked for at goals only
    legs: int = 0  # the drive stops after each
    terms_mm: tuple[float, ...] = ()  # what the scenario's own terms cost, in their order
    room_m: float = np.inf  # smallest clearance of corner shapes beyond what is required

    @cached_property
    def end_error_m(self) -> float:
        """What friction leaves at its end that no compensation knows, by the friction law."""
        return self.left_m()


class Stations(NamedTuple):
    """Zero-clearance shapes along a motion."""

    joints: Array  # (S, m)
    room_m: Array  # (S,) smallest clearance beyond what is required
    jumps: bool  # whether the tip does, which is a cheap hint that the robot snaps: the solution changes its branch


class MotionChecker:
    """Checks and prices motions of a scenario; remembers every one it was asked about.

    Threads may share it. It pickles as what it was made of, and has then checked nothing yet.
    """

    @checked(
        scenario=Made("Scenario"),
        style=Choice(*get_args(MotionStyle)),
        meter=Made("WorkMeter"),
        reserve_m=Number(0.0, 1.0, "m"),
    )
    def __init__(
        self,
        scenario: Scenario,
        style: MotionStyle = "rotations before translations",
        meter: WorkMeter | None = None,
        reserve_m: float = SEARCH_ROOM_M,
    ) -> None:
        """`reserve_m` is kept beyond the margins, so that paths pass the certificate."""
        self.scenario, self.style = scenario, style
        self.space, self.m = JointSpace.of(scenario), len(scenario.robot.drive.joints)
        self.mechanics, self.field = scenario.robot.mechanics, robot_field(scenario)
        self.density = PathDensity(rotation_rad=0.26, translation_m=8e-3, motion_m=15e-3, between_corners=True)
        self.reserve_m = reserve_m
        self.limits = search_limits(scenario, reserve_m)
        check_terms(scenario)
        self.calls = 0  # into the core
        self.meter, self.watch = meter or WorkMeter(), SearchWatch()  # which is asked before anything is solved
        self.solved_ns = SHAPE_NS * (1 + 2 ** (scenario.robot.n - 1))
        self._known: dict[bytes, Motion] = {}
        self._ahead: dict[bytes, tuple[Motion, int]] = {}  # checked before they were asked for, and work [ns]
        self._states: dict[bytes, tuple[Motion, PathSamples | None]] = {}
        self._between: dict[bytes, float] = {}  # clearances [m] over friction states between the corners

    def __reduce__(self) -> tuple[Any, ...]:
        """What it was made of."""
        return type(self), (self.scenario, self.style, None, self.reserve_m)

    def check(self, states: ArrayLike, *, threads: int = 0) -> tuple[Motion, ...]:
        """States (K, m) as motions of no length, on so many threads, 0: every core. Invalid rows have their reason.

        Raises InputError for an array of another shape alone.
        """
        return self._rows(self.state, threads, states)

    @checked(gradient=Flag(), parameters=Texts(), threads=THREADS)
    def clearance(
        self, states: ArrayLike, *, gradient: bool = False, parameters: Sequence[str] = (), threads: int = 0
    ) -> Clearances:
        """What states (K, m), or one (m,), leave to the anatomy, exactly; NaN beyond limits.

        With `gradient` by joints, base pose and `parameters` of the robot's file, as of `Robot.bound`.
        """
        rows, scenario = np.atleast_2d(numbers(states, "joint values")), self.scenario
        self.space.drive.warn_of_degrees("joint values", rows)
        return clearances(
            self.mechanics,
            self.space.drive.collars(rows),
            self.space.drive.collars_by_joints(rows) if gradient else None,
            (scenario.base_R, scenario.base_position_m),
            partial(exact_clearance_of_many, scenario.anatomy),
            spacing_m=self.density.point_spacing_m,
            kept=self.space.allowed_rows(rows),
            parameters=parameters,
            threads=threads,
        )

    def motions(self, a: ArrayLike, b: ArrayLike, *, threads: int = 0) -> tuple[Motion, ...]:
        """Motions from rows of a (K, m) to those of b (K, m), in the checker's style; as `check`."""
        return self._rows(self._known_motion, threads, a, b)

    @checked(threads=THREADS)
    def _rows(self, ask: Callable[..., Motion], threads: int, *arrays: ArrayLike) -> tuple[Motion, ...]:
        rows = [numbers(array, "joint values") for array in arrays]
        for array in rows:
            if array.shape != (len(rows[0]), self.m):
                raise InputError(f"must have shape (K, {self.m}), K alike, not {array.shape}", key="joint values")
            self.space.drive.warn_of_degrees("joint values", array)

        def answer(*row: Array) -> Motion:
            return ask(*row) if all(np.isfinite(q).all() for q in row) else invalid("joint values must be finite")

        with ThreadPoolExecutor(threads or cores()) as pool:
            return tuple(pool.map(answer, *rows))

    def motion(self, a: ArrayLike, b: ArrayLike) -> Motion:
        """The motion from joint values a to b, (m,) each, in the checker's style. Raises InputError."""
        if not (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape == (self.m,)):
            a, b = vector("joint values", a, self.m), vector("joint values", b, self.m)
        if a.tobytes() + b.tobytes() not in self._known:
            self.space.drive.warn_of_degrees("joint values", (a, b))
        return self._known_motion(a, b)

    def _known_motion(self, a: Array, b: Array) -> Motion:
        self.meter.add(ASKED_NS)
        key = a.tobytes() + b.tobytes()
        result = self._known.get(key)
        if result is None:
            if ahead := self._ahead.pop(key, None):
                result, spent_ns = ahead
                self.meter.add(spent_ns)
            else:
                result = self._motion(a, b)
            self._known[key] = result
        return result

    def look_ahead(self, a: Array, b: Array) -> None:
        """Checks a motion that is likely asked for next; it counts as work when it is."""
        key = a.tobytes() + b.tobytes()
        if key not in self._known and key not in self._ahead:
            with counted_aside() as aside:
                self._ahead[key] = self._motion(a, b), aside.spent_ns

    def _motion(self, a: Array, b: Array) -> Motion:
        corners = self.space.corners(a, b, self.style)
        return self.refusal(corners) or self.along(corners)

    def refusal(self, corners: Array) -> Motion | None:
        """Why a polyline (K, m) is not worth a walk, by a solve or none; None if it is.

        It collides where zero-clearance shapes have least room: by so much that their room tells, or as solved there.
        """
        if self.field is None or not self.space.allowed(corners):
            return None
        points = self.stations(corners)
        rooms, _ = self._rooms_and_tips(*self.space.drive.collars(points))
        narrowest = int(np.argmin(rooms))
        if rooms[narrowest] < DEFINITE_COLLISION_M:
            return invalid(DEFINITE_COLLISION)
        if rooms[narrowest] >= DOUBTFUL_M:
            return None
        state, _ = self.probe(points[narrowest])
        return None if state.valid else state

    def is_definite_collision(self, q: Array) -> bool:
        """Whether the zero-clearance shape at q (m,) collides by so much that the state is not worth a solve."""
        return self.space.allowed(q) and bool(self.state_rooms(q[None])[0] < DEFINITE_COLLISION_M)

    def without_reserve(self) -> MotionChecker:
        """A checker that keeps no reserve; it has checked nothing yet."""
        return MotionChecker(self.scenario, self.style, self.meter, reserve_m=0.0)

    def state(self, q: Array) -> Motion:
        """A single state as a motion of no length."""
        if q.tobytes() not in self._states and self.is_definite_collision(q):
            return invalid(DEFINITE_COLLISION)
        return self.probe(q)[0]

    def probe(self, q: Array) -> tuple[Motion, PathSamples | None]:
        """A single state, and what the core says of it; None where limits or nesting forbid it."""
        self.meter.add(ASKED_NS)
        if (key := q.tobytes()) not in self._states:
            self._states[key] = self._probe(q[None, :])
        return self._states[key]

    def solved_room_m(self, q: Array) -> float:
        """What a state (m,) that was solved leaves beyond the clearance required; NaN where none was."""
        _, samples = self._states.get(q.tobytes(), (None, None))
        return np.nan if samples is None else float(samples.clearance_m[-1]) - self.limits.clearance_m

    def _probe(self, q: Array) -> tuple[Motion, PathSamples | None]:
        if not self.space.allowed(q):
            return invalid(self.space.violation(q)), None
        samples = self.walk(q, self.density, self.limits)
        reason = breach(samples, self.limits)
        bound = float(samples.position_m[-1])
        return invalid(reason) if reason else Motion(True, "", 0.0, 0.0, bound, lambda: bound), samples

    def forbid(self, a: Array, b: Array, reason: str) -> None:
        """Remembers that the motion from a to b failed a stricter check."""
        self._known[a.tobytes() + b.tobytes()] = invalid(reason)

    def along(self, corners: Array, *, remembers: bool = False) -> Motion:
        """The polyline (K, m) of joint values; one thread alone may ask that no leg is walked twice."""
        if not self.space.allowed(corners):
            return invalid(self.space.violation(corners))
        samples = self.known_walk(corners) if remembers else self.walk(corners, self.density, self.limits)
        return self.judged(corners, samples)

    def judged(self, corners: Array, samples: PathSamples) -> Motion:
        """What a walk of a polyline (K, m) is worth."""
        close = np.flatnonzero(samples.clearance_m < self.limits.clearance_m)
        broken = breach(samples.at_rows(close[:1]) if len(close) else samples, self.limits)
        if reason := broken or self._between_corners(corners, samples):
            return invalid(reason)
        error = self.errors(corners, samples)
        length, integral = self.price(corners, samples, error)
        bound, last = float(samples.position_m[-1]), samples.at_end()
        left = partial(left_at_end, self.scenario, corners, last, float(error[-1]))
        terms_mm, room_m = self.terms_mm(corners), float(samples.clearance_m.min()) - self.limits.clearance_m
        return Motion(True, "", length, integral, bound, left, count_legs(corners), terms_mm, room_m)

    def known_walk(self, corners: Array) -> PathSamples:
        """Samples along a polyline (K, m), also where it is up to ASTRAY_M too close; no leg is walked twice."""
        return self._legs.along(corners)

    @cached_property
    def _legs(self) -> KnownLegs:
        astray = replace(self.limits, clearance_m=self.limits.clearance_m - ASTRAY_M)
        return KnownLegs(lambda way: self.walk(way, self.density, astray), lambda end: bool(breach(end, astray)))

    def walk(self, corners: Array, density: PathDensity, limits: PathLimits) -> PathSamples:
        """The core's samples along a polyline."""
        self.watch.ask()
        theta_b, l_b = self.space.drive.collars(corners)
        self.calls += 1
        samples = self.mechanics.check_path(theta_b, l_b, self.field, density=density, limits=limits)
        self.meter.add(self.solved_ns * int(samples.solves.sum()))
        return samples

    def _between_corners(self, corners: Array, samples: PathSamples) -> str:
        """Why a valid walk of a polyline (K, m) is refused in friction states between the corners; empty if it is not.

        They are looked at where the walk of a leg has least clearance.
        """
        if self.field is None or not samples.nearest_phi.size:
            return ""
        for leg in range(len(corners) - 1):
            on_leg = np.flatnonzero(samples.segment == leg)
            row = on_leg[np.argmin(samples.clearance_m[on_leg])]
            q = corners[leg] + samples.fraction[row] * (corners[leg + 1] - corners[leg])
            if reason := self._too_close_between(q, samples.at_rows([row])):
                return reason
        return ""

    def _too_close_between(self, q: Array, sample: PathSamples) -> str:
        """Why friction states between the corners refuse q (m,), sampled there; empty if they do not.

        They are solved where an interpolated shape is nearer than the corners', and friction moves bodies by more than
        is left.
        """
        phi, key = sample.nearest_phi[0], q.tobytes()
        if (
            self.field is None
            or np.isnan(phi).any()
            or sample.clearance_m[0] - self.limits.clearance_m >= sample.position_m[0]
        ):
            return ""
        if key not in self._between:
            spacing_m, tip_m = self.density.point_spacing_m, sample.tip_m[0]
            self._between[key], solved = clearance_between(self.scenario, self.field, q, phi, tip_m, spacing_m)
            self.meter.add(SHAPE_NS * solved)
        short_mm = (self.limits.clearance_m - self._between[key]) * MM_PER_M
        return f"a shape that friction allows comes {short_mm:.2f} mm {TOO_CLOSE}" if short_mm > 0 else ""

    def rooms(self, ways: list[Array]) -> Array:
        """(E,) [m] smallest clearance of zero-clearance shapes on polylines (K, m) each, beyond what is required.

        A cheap hint whether they are valid: friction and clearance between tubes move shapes by millimetres.
        """
        if self.field is None or not ways:
            return np.full(len(ways), np.inf)
        return np.array([stations.room_m.min() for stations in self.look(ways)])

    def state_rooms(self, q: Array) -> Array:
        """(K,) [m] clearance of zero-clearance shapes at states (K, m), beyond what is required."""
        return self._rooms_and_tips(*self.space.drive.collars(q))[0]

    def look(self, ways: list[Array]) -> list[Stations]:
        """Zero-clearance shapes on polylines (K, m) each, which say cheaply what to expect of them."""
        points = [self.stations(way) for way in ways]
        theta_b, l_b = self.space.drive.collars(np.concatenate(points))
        rooms, tips = self._rooms_and_tips(theta_b, l_b)
        lasts = np.cumsum([len(of_way) for of_way in points[:-1]], dtype=int)
        rows = zip(points, *(np.split(values, lasts) for values in (rooms, tips, l_b)), strict=True)
        return [Stations(q, room_m, _jumps(tip_m, lengths)) for q, room_m, tip_m, lengths in rows]

    def _rooms_and_tips(self, theta_b: Array, l_b: Array) -> tuple[Array, Array]:
        """Clearances (K,) [m] of shapes at collars (K, n) beyond what is required, and tips (K, 3) [m]."""
        self.watch.ask()
        self.meter.add(ROOM_NS * len(l_b))
        threads = 0 if len(l_b) > FEW else 1
        if self.field is None:
            return np.full(len(l_b), np.inf), self.mechanics.tips(theta_b, l_b, threads=threads, loads=False)[0]
        rooms, tips = self.mechanics.zero_clearance_rooms(theta_b, l_b, self.field, threads=threads)
        return rooms - self.limits.clearance_m, tips

    def stations(self, corners: Array) -> Array:
        """(S, m) points on a polyline no farther apart than the density's steps."""
        longest = np.where(self.space.drive.is_rotation, self.density.rotation_rad, self.density.translation_m)
        results = [corners[:1]]
        for a, b in zip(corners[:-1], corners[1:], strict=True):
            count = max(1, int(np.ceil(np.abs((b - a) / longest).max())))
            results += [a + np.arange(1, count)[:, None] / count * (b - a), b[None]]  # b itself, which may be known
        return np.concatenate(results)

    def errors(self, corners: Array, samples: PathSamples) -> Array:
        """(K,) [m] friction errors on a walked polyline that starts fully loaded, by the robot's friction law.

        Never more than the bound; equal to it as long as nothing was released.
        """
        theta_b, l_b = self.space.drive.collars(corners)
        load, loads = np.ones(self.scenario.robot.n - 1), []
        for leg in range(samples.segment[-1] + 1):
            share = samples.fraction[samples.segment == leg]
            ends = slice(leg, leg + 2) if len(corners) > 1 else [0, 0]
            loads.append(friction_law(self.scenario.robot).load_left(load, theta_b[ends], l_b[ends], share))
            load = loads[-1][-1] if len(share) else load
        return released_error(samples, np.concatenate(loads))

    def price(self, corners: Array, samples: PathSamples, error: Array) -> tuple[float, float]:
        """Weighted joint length [mm] and the integral [mm] of errors (K,) [m] of a walked polyline."""
        if len(corners) == 1:
            return 0.0, 0.0
        lengths = self._lengths(corners)
        before = np.concatenate([[0.0], np.cumsum(lengths)])
        travelled = before[samples.segment] + samples.fraction * lengths[samples.segment]
        integral = np.trapezoid(error * MM_PER_M, travelled) / self.scenario.cost.mm_per_rad
        return float(lengths.sum()), float(integral)

    def _lengths(self, corners: Array) -> Array:
        """Weighted joint lengths [mm] of a polyline's legs."""
        return np.array([self.space.length_mm(d) for d in np.diff(corners, axis=0)])

    def terms_mm(self, corners: Array) -> tuple[float, ...]:
        """What the scenario's own terms cost on a polyline (K, m), valid or not; a state alone costs nothing."""
        return terms_mm(self.scenario, corners)

    def cost_mm(self, motion: Motion, *, ends_at_goal: bool) -> float:
        """Weighted cost of a motion; at the goal it pays for the worst case there and for what is unknown of it."""
        return sum(motion.terms_mm) + path_cost_mm(
            self.scenario.cost,
            length_mm=motion.length_mm,
            legs=motion.legs,
            integral_mm=motion.error_integral_mm,
            left_m=motion.end_bound_m + motion.end_error_m if ends_at_goal else 0.0,
        )


def count_legs(corners: Array) -> int:
    """Legs of a polyline (K, m) that go anywhere."""
    return int(np.any(np.diff(corners, axis=0), axis=1).sum())


def invalid(reason: str) -> Motion:
    """A motion that must not be made."""
    return Motion(False, reason, np.inf, np.inf, np.inf, lambda: np.inf)


def left_at_end(
    scenario: Scenario, corners: Array, samples: PathSamples, loaded_m: float, load: Array | None = None
) -> float:
    """[m] that friction may leave of the tip's error at the end of a walked polyline (K, m), by the friction law.

    That is what friction before it leaves unknown, the load (P,) then full unless it is given; and of the error that
    the load at its end makes, `loaded_m`, the share by which coefficients are uncertain. The rest is compensated, but
    for a goal in joint values, which is driven to as it is: there all of it is left.
    """
    robot, share = scenario.robot, COEFFICIENTS if scenario.goal.joints is None else 1.0
    before = np.ones(robot.n - 1) if load is None else load
    left = friction_law(robot).unknown_after(before, *robot.drive.collars(corners))
    last = samples.at_end()
    unknown = float(released_error(last, left[None])[0])
    return min(unknown + share * loaded_m, float(last.position_m[0]))


def robot_field(scenario: Scenario) -> Field | None:
    """The scenario's anatomy as a grid for the core; None in free space."""
    grid = anatomy_grid(scenario)
    if grid is None:
        return None
    return Field(grid.values_m, grid.origin_m, float(grid.spacing_m), scenario.base_R, scenario.base_position_m)


def _jumps(tips: Array, l_b: Array) -> bool:
    """Whether a step between tips (S, 3) [m] is much longer than those beside it and than l_b (S, n) [m] moves."""
    steps = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    if len(steps) < 2:
        return False
    around = np.maximum(np.append(0.0, steps[:-1]), np.append(steps[1:], 0.0))
    driven = np.abs(np.diff(l_b, axis=0)).max(axis=1)
    return bool(np.any(steps > JUMP * around + driven + JUMP_M))
