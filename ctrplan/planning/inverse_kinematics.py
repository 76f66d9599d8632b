"""Every way found to bring the tip to a point, and steps that lead it along points: `ctrplan.inverse_kinematics` and
`ctrplan.TipTracker`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import DIRECTION_TOLERANCE_DEG, MOST_STARTS, SEED, Number, Whole, checked, require
from ctrplan.base.arrays import LONGEST_MM, MM_PER_M, UNITS_M, Array, numbers
from ctrplan.base.package import of_this_process, shown, warn_caller
from ctrplan.errors import InputError, said_of
from ctrplan.mechanics.core_arrays import TipMemory
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.limits import breach, path_limits
from ctrplan.planning.reach import REFINED_SHARE, SHORTER, Configuration, Reach, reach, tips_by_joints
from ctrplan.planning.room import closer_by_joints, rooms_on_stretches
from ctrplan.robot.observer import ObserverState
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.prediction import begun_histories
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.sizes import place_doubt
from ctrplan.scenario.tip_solver import NO_STEP_M, MotionLines, TipSolver, TipTarget, angle_to, miss_of

if TYPE_CHECKING:
    from ctrplan.mechanics.history import History, HistoryState
    from ctrplan.mechanics.walk import PathSamples
    from ctrplan.scenario.prediction import FrictionStart

TOLERANCE_M = 1e-4
STARTS = 400
FARTHEST_M = LONGEST_MM * 1e-3


@shown
@dataclass(frozen=True, eq=False)
class InverseKinematics:
    """Ways to a point; positions in the robot's frame, as those of `Configuration` are."""

    scenario: Scenario  # of a robot alone, in free space
    solutions: Reach

    @property
    def configurations(self) -> tuple[Configuration, ...]:
        """All that reach the point within the tolerances, lowest bound first; `reason` says why one is not valid."""
        return self.solutions.configurations

    @property
    def valid(self) -> tuple[Configuration, ...]:
        """Configurations that keep all limits and margins."""
        return tuple(c for c in self.configurations if c.valid)

    @property
    def nearest(self) -> Configuration:
        """The frictionless tip that came closest, whatever else it does."""
        return self.solutions.nearest

    @cached_property
    def branches(self) -> tuple[int, ...]:
        """Number of each configuration's branch, from 0: those of one branch lead to each other at the point."""
        return tuple(self.solutions.branches().tolist())

    @property
    def sentence(self) -> str:
        """What was found."""
        count, valid = len(self.configurations), len(self.valid)
        if not count:
            return self._unreached
        ways = "1 configuration reaches" if count == 1 else f"{count} configurations reach"
        if valid:
            return f"{ways} the point, {valid} of them within all limits and margins."
        return f"{ways} the point, none within all limits and margins: {self.configurations[0].reason}."

    @property
    def _unreached(self) -> str:
        nearest = self.nearest
        if nearest.tip_error_m <= self.solutions.tolerance_m:
            turned = math.degrees(nearest.turned_rad)
            allowed = math.degrees(self.solutions.direction_tolerance_rad)
            return (
                f"The point is reached, but at best {turned:.1f} deg from the direction, {allowed:g} deg are allowed."
            )
        return f"The point is out of reach, the nearest tip found is {nearest.tip_error_m * 1e3:.3g} mm away."


@checked(
    tolerance_m=Number(1e-6, 1.0, "m"),
    direction_tolerance_rad=Number(0, math.pi, "rad", above=True),
    starts=Whole(1, MOST_STARTS),
    seed=SEED,
)
def inverse_kinematics(
    robot_or_scenario: Robot | Scenario,
    tip_m: ArrayLike,
    direction: ArrayLike | None = None,
    *,
    tolerance_m: float = TOLERANCE_M,
    direction_tolerance_rad: float | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> InverseKinematics:
    """Distinct configurations whose frictionless tip is within `tolerance_m` of a point (3,) [m].

    A scenario's point, and a direction (3,) of the tip of any length, are in the anatomy's frame; a robot's in its own.
    The direction may be off by `direction_tolerance_rad`, by default 5 deg. `starts` random configurations, drawn by
    `seed`, are where solves begin. Nothing found is no error: see `InverseKinematics.sentence`. Raises InputError.
    """
    scenario = _scenario(robot_or_scenario)
    target = _target(scenario, tip_m, direction, direction_tolerance_rad)
    checker = MotionChecker(scenario)
    checker.limits = path_limits(scenario)  # the scenario's own, without what a search adds, as in the live view
    return InverseKinematics(
        scenario, reach(checker, target, float(tolerance_m), np.random.default_rng(seed), int(starts))
    )


def refuse_wrong_unit(scenario: Scenario, tip: ArrayLike, unit: Literal["m", "mm"], key: str) -> str:
    """A doubt about a point (3,) whose numbers make sense in another unit, or ""; InputError for no sense in `unit`."""
    point = numbers(tip, key)
    if point.shape != (3,) or not np.isfinite(point).all():
        return ""  # which is refused for that
    doubt = place_doubt(scenario.robot, point * UNITS_M[unit], scenario.base_position_m, unit, scenario.anatomy)
    if doubt is None:
        return ""
    fault = InputError(doubt.rule, key=key, value=point.tolist(), unit=unit)
    if doubt.is_sure:
        raise fault
    return str(fault)


def _scenario(given: Robot | Scenario) -> Scenario:
    if isinstance(given, Scenario):
        return given
    if isinstance(given, Robot):
        return bare_scenario(given)
    raise InputError("must be a Robot or a Scenario", key="robot_or_scenario", value=given)


def _target(
    scenario: Scenario, tip_m: ArrayLike, direction: ArrayLike | None, tolerance_rad: float | None
) -> TipTarget:
    """The point and direction asked for, in the robot's frame."""
    if doubt := refuse_wrong_unit(scenario, tip_m, "m", "tip_m"):
        warn_caller(doubt)
    tip = scenario.base_R.T @ (_vector("tip_m", tip_m, FARTHEST_M, "m") - scenario.base_position_m)
    if direction is None:
        if tolerance_rad is not None:
            raise InputError("goes with direction", key="direction_tolerance_rad", value=tolerance_rad)
        return TipTarget(tip)
    given = _vector("direction", direction, 1e12)
    largest = np.abs(given).max()
    if largest == 0:
        raise InputError("must not be zero", key="direction", value=given.tolist())
    scaled = given / largest  # so that squares do not vanish
    along = scenario.base_R.T @ (scaled / np.linalg.norm(scaled))
    allowed = math.radians(DIRECTION_TOLERANCE_DEG) if tolerance_rad is None else float(tolerance_rad)
    return TipTarget(tip, along, allowed)


def _vector(key: str, value: ArrayLike, largest: float, unit: str | None = None) -> Array:
    """Three numbers (3,), none beyond `largest`. Raises InputError."""
    vector = numbers(value, key)
    if vector.shape != (3,):
        raise InputError("must be three numbers", key=key, value=value, unit=unit)
    for component in vector.tolist():
        require(key, component, Number(-largest, largest, unit))
    return vector


TrackStatus = Literal["reached", "limited", "shortened", "stopped"]

STEP_S = 0.05  # between steps at 20 Hz
LOOKS = 4  # by a known history, before a way is walked
ATTEMPTS = 2  # at a step, of which those after the first one correct what the tip and the body did


@shown
@dataclass(frozen=True, eq=False)
class TrackedStep:
    """Where a step led, which keeps all limits and margins; positions in the frame of the points that are asked for."""

    status: TrackStatus
    reason: str  # what holds it short of the point; empty where it is reached
    joints: Array  # (m,)
    tip_m: Array  # (3,) expected: with friction where that is known, else without
    tip_error_m: float  # of the expected tip
    turned_rad: float  # of its tangent from the direction asked for
    bound_m: float  # how far friction, whatever it is, moves the tip from the frictionless one
    bound_rad: float
    stability: float
    clearance_m: float  # of all shapes beyond the anatomy's margins; inf in free space

    @property
    def sentence(self) -> str:
        """What it did."""
        left = (
            f"tip {self.tip_error_m * 1e3:.3g} mm from the point, worst-case friction error {self.bound_m * 1e3:.3g} mm"
        )
        return f"{self.status}: {left}" + (f", {self.reason}." if self.reason else ".")


@dataclass(frozen=True, eq=False)
class _Tip:
    """A configuration and its expected tip."""

    joints: Array  # (m,)
    pose: Array  # (1, 6) tip and tangent, robot's frame; NaN without an equilibrium
    phi: Array  # (1, n - 1) friction state of each pair, averaged
    history: HistoryState | None = None  # there, where friction is known


@dataclass(frozen=True, eq=False)
class _Place:
    """A configuration that was walked to."""

    tip: _Tip
    at: PathSamples  # what the core says, at the end of its rows


class TipTracker:
    """Leads the tip along a stream of points, step by step from the joints before. One thread at a time.

    A step is a damped least-squares step by the tip's exact derivatives, within the joints' limits, nesting, what the
    drive can turn and slide in the time, and the clearance as the body's motion changes it; derivatives of the body are
    those of the zero-clearance model. It is made where a walk to its end keeps all limits and margins with friction in
    every corner, else a shorter one. Speeds are kept, accelerations are not looked at.
    """

    __reduce__ = of_this_process("make another where this one stands")

    @checked(tolerance_m=Number(1e-6, 1.0, "m"))
    def __init__(
        self,
        robot_or_scenario: Robot | Scenario,
        joints: ArrayLike,
        *,
        friction: FrictionStart | ObserverState | None = None,
        tolerance_m: float = TOLERANCE_M,
    ) -> None:
        """`joints` (m,) [rad, m] is where the robot stands; `friction` what is known of it there, see `know`.

        Raises InputError for joints that break a limit or margin.
        """
        import scipy.optimize  # noqa: F401  # now, not in the time of the first step

        self.scenario, self.tolerance_m = _scenario(robot_or_scenario), float(tolerance_m)
        self._checker = MotionChecker(self.scenario)
        self._checker.limits = path_limits(self.scenario)
        self._space, self._mechanics = self._checker.space, self._checker.mechanics
        self._solver, self._walker = TipSolver(self._space, self._mechanics), self._mechanics.core_walker("search")
        q = numbers(joints, "joints").copy()
        if q.shape != (len(self._space.weights_mm),) or not np.isfinite(q).all():
            raise InputError(f"must be {len(self._space.weights_mm)} finite numbers", key="joints", value=joints)
        self._space.drive.warn_of_degrees("joints", q)
        if not self._space.allowed(q):
            raise InputError(self._space.violation(q[None]), key="joints")
        samples = self._walk(q[None])
        if reason := breach(samples, self._checker.limits):
            raise InputError(f"must keep limits and margins: {reason}", key="joints")
        self._history: History | None = None
        self._stopped: tuple[_Place, float, MotionLines] | None = None
        self._offset_m, self._known = np.zeros(3), TipMemory()
        self._here = _Place(self._frictionless(q, samples), samples)
        self.know(friction)

    @property
    def joints(self) -> Array:
        """(m,) where it stands."""
        return self._here.tip.joints.copy()

    @said_of("friction")
    def know(self, friction: FrictionStart | ObserverState | None) -> None:
        """What is known of friction at the joints where it stands, of which the tip is expected from there on.

        "released", "oscillated", a share of each pair, or a state of a history or observer, whose likeliest history is
        followed; None: nothing, and the expected tip is the frictionless one. Raises InputError for what can't be here.
        """
        q, samples, offset_m = self._here.tip.joints, self._here.at, np.zeros(3)
        if isinstance(friction, ObserverState):
            friction.check(self._mechanics, *self._space.drive.collars(q))
            offset_m, friction = friction.offset_m, friction.histories[0]
        if friction is None:
            self._history, self._here = None, _Place(self._frictionless(q, samples), samples)
            return
        history = begun_histories(self.scenario.robot, [friction])[0]
        tip = self._followed(history, offset_m, q)
        if not np.isfinite(tip.pose).all():
            raise InputError("has no equilibrium at these joints", key="friction")
        self._history, self._offset_m, self._here = history, offset_m, _Place(tip, samples)

    @checked(dt_s=Number(1e-4, 60.0, "s"), direction_tolerance_rad=Number(0, math.pi, "rad", above=True))
    def step(
        self,
        tip_m: ArrayLike,
        direction: ArrayLike | None = None,
        *,
        direction_tolerance_rad: float | None = None,
        dt_s: float = STEP_S,
    ) -> TrackedStep:
        """Moves towards a point (3,) [m] and direction (3,) of `inverse_kinematics`, as far as `dt_s` allows.

        Nothing moves where no step keeps all limits. Raises InputError.
        """
        target = _target(self.scenario, tip_m, direction, direction_tolerance_rad)
        begin = self._here
        best, shortened, broken = self._led(begin, target, dt_s)
        status: TrackStatus = "stopped" if broken and best is begin else "shortened" if shortened else "limited"
        self._here = best
        if self._history is not None and best.tip.history is not None:
            self._history.restore(best.tip.history)
        return self._result(target, status, broken)

    def _led(self, begin: _Place, target: TipTarget, dt_s: float) -> tuple[_Place, bool, str]:
        """Where least squares lead: the last place that keeps all limits, whether it is short of that, why it must be.

        A place off the target or too close to the anatomy is corrected by what the tip and the body did on the way,
        where that is expected to take off REFINED_SHARE of what is left: along a wall hardly.
        """
        best, tip, broken, why = begin, begin.tip, "", ""
        if np.linalg.norm(miss_of(target, tip.pose)[0]) <= REFINED_SHARE * self.tolerance_m:
            return begin, False, ""
        lines = self._lines(begin, dt_s)
        for _ in range(ATTEMPTS):
            joints, ahead = self._aimed(begin, target, tip, lines, SHORTER if broken else 1.0)
            if np.abs((joints - best.tip.joints) * lines.weights).max() <= NO_STEP_M:
                break
            earlier, (place, broken) = broken, self._placed(begin, joints, ahead)
            if broken:
                lines.learn_body(joints, rooms_on_stretches(self._checker, place.at))
                self._stopped = begin, dt_s, lines
                continue
            if ahead is None:
                lines.learn_tip(place.tip.joints - tip.joints, place.tip.pose - tip.pose)
            best, tip, why = place, place.tip, earlier
            if np.linalg.norm(miss_of(target, tip.pose)[0]) <= self.tolerance_m:
                break
        return best, bool(why), why or (broken if best is begin else "")

    def _aimed(
        self, begin: _Place, target: TipTarget, tip: _Tip, lines: MotionLines, share: float
    ) -> tuple[Array, _Tip | None]:
        """Joint values (m,) by least squares from where the tip is known, and the tip there, if friction is known.

        A known history is asked until the tip is where it should be, but not where a way was refused before.
        """
        best, least, joints = None, np.inf, tip.joints
        for _ in range(1 if self._history is None or lines.refused else LOOKS):
            motion = lines.motion(target, tip.joints, tip.pose)
            joints = self._space.projected((lines.joints + share * motion)[None], fallback=lines.joints[None])[0]
            if tip is not begin.tip and not lines.gain(target, tip.joints, tip.pose, joints) > REFINED_SHARE:
                joints = tip.joints
                break
            ahead = None if lines.refused else self._foreseen(begin, joints)
            if ahead is None or not np.isfinite(ahead.pose).all():
                break
            off_m = float(np.linalg.norm(miss_of(target, ahead.pose)[0]))
            unforeseen_m = lines.learn_tip(ahead.joints - tip.joints, ahead.pose - tip.pose)
            best, least, tip = (ahead, off_m, ahead) if off_m < least else (best, least, ahead)
            if min(off_m, unforeseen_m) <= self.tolerance_m:
                break
        return (joints, None) if best is None else (best.joints, best)

    def _lines(self, begin: _Place, dt_s: float) -> MotionLines:
        """Where it stands; with what was learned of the body there, if it could not leave."""
        if self._stopped is not None and self._stopped[0] is begin and self._stopped[1] == dt_s:
            return self._stopped[2]
        q, drive, weights = begin.tip.joints, self._space.drive, self._space.weights_mm / MM_PER_M
        most, identity, (nesting, nested) = drive.max_velocity * dt_s, np.eye(len(weights)), self._space.nesting_rules
        up, down = (np.minimum(left, most) for left in (drive.upper - q, q - drive.lower))
        tips = tips_by_joints(self._checker, q[None], begin.tip.phi, (self._known, [0]))
        closer, spare, near = closer_by_joints(self._checker, self._solver, q, begin.at, most)
        return MotionLines(
            joints=q,
            weights=weights,
            slope=np.vstack([tips.position_by[0], tips.tangent_by[0]]) / weights,
            rows=np.vstack([identity, -identity, nesting]) / weights,
            room=np.maximum(np.concatenate([up, down, nested - nesting @ q]), 0.0),
            closer=closer / weights,
            spare=spare,
            near=near,
        )

    def _placed(self, begin: _Place, q: Array, ahead: _Tip | None = None) -> tuple[_Place, str]:
        """Joint values (m,) as a place that is reached from another, and which limit it or the way breaks, if any."""
        samples = self._walk(np.array([begin.tip.joints, q]))
        broken = breach(samples, self._checker.limits)
        tip = ahead or (None if broken else self._foreseen(begin, q)) or self._frictionless(q, samples)
        lost = "" if np.isfinite(tip.pose).all() else "no equilibrium was found along the path"
        return _Place(tip, samples), broken or lost

    def _foreseen(self, begin: _Place, q: Array) -> _Tip | None:
        """The tip at joint values (m,) after a motion there, if friction is known."""
        if self._history is None or begin.tip.history is None:
            return None
        self._history.restore(begin.tip.history)
        return self._followed(self._history, self._offset_m, q)

    def _followed(self, history: History, offset_m: Array, q: Array) -> _Tip:
        """The tip after a history is led to joint values (m,)."""
        path = history.follow(*self._space.drive.collars(q[None]))
        pose = np.hstack([path.position_m + offset_m, path.tangent])
        return _Tip(q, pose, np.clip(np.nan_to_num(path.phi), -1, 1), history.save())

    def _frictionless(self, q: Array, samples: PathSamples) -> _Tip:
        """The tip at the end of a walk to joint values (m,)."""
        pose = np.concatenate([samples.tip_m[-1], samples.tip_tangent[-1]])[None]
        return _Tip(q, pose, np.zeros((1, self._mechanics.n - 1)))

    def _walk(self, corners: Array) -> PathSamples:
        """What the core says along a polyline (K, m), with bodies."""
        checker, collars = self._checker, self._space.drive.collars(corners)
        return self._mechanics.check_path(
            *collars, checker.field, density=checker.density, limits=checker.limits, bodies=True, walker=self._walker
        )

    def _result(self, target: TipTarget, status: TrackStatus, reason: str) -> TrackedStep:
        here, samples = self._here.tip, self._here.at
        tip, tangent = here.pose[0, :3], here.pose[:, 3:]
        error, turned = float(np.linalg.norm(tip - target.tip_m)), float(angle_to(tangent, target.direction)[0])
        if error <= self.tolerance_m and turned <= target.direction_tolerance_rad:
            status, reason = "reached", ""
        elif not reason:
            reason = "limits of joints, speeds or clearance hold it"
        return TrackedStep(
            status=status,
            reason=reason,
            joints=here.joints.copy(),
            tip_m=self.scenario.located(tip),
            tip_error_m=error,
            turned_rad=turned,
            bound_m=float(samples.position_m[-1]),
            bound_rad=float(samples.tangent_rad[-1]),
            stability=float(samples.stability[-1]),
            clearance_m=float(samples.clearance_m[-1]) if self._checker.field else np.inf,
        )
