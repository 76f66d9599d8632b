"""Joint space of a drive: differences, lengths, L-shaped motions, and where a robot begins when nobody says it.

Nothing of OMPL here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import Made, checked
from ctrplan.base.arrays import MM_PER_M, ROUNDING_M, Array, numbers, read_only, to_be_read
from ctrplan.drive.drive import JOINT_ROUNDING, STEP_M, STEP_RAD, Drive
from ctrplan.errors import InputError, of_the_user
from ctrplan.mechanics.tube import reach_inequalities
from ctrplan.robot.robot import Robot, nesting_sentence
from ctrplan.scenario.scenario import CATALOGUE, DEFAULT, CostTerm, Goal, Margins, Scenario

MotionStyle = Literal["rotations before translations", "simultaneous"]

PROJECTIONS = 12  # rounds over limits and nesting, which are few and nearly orthogonal
BENT_STEP_RAD, BENT_STEP_M = 2 * STEP_RAD, 2 * STEP_M  # of a joint, along which a drive with effects moves straight
BOW = BENT_STEP_RAD / 8  # share of a step off its chord: what an arc of a radian leaves, turned by a step
MM_PER_RAD = 20.0  # where no scenario says otherwise


@dataclass(frozen=True, eq=False)
class JointSpace:
    """Actuated joints (m,) in rad and m, weighted to mm."""

    drive: Drive
    weights_mm: Array  # (m,) mm of joint length per rad or m
    nesting_G: Array  # (r, n)
    nesting_h: Array  # (r,) base translations are allowed where nesting_G @ l_b <= nesting_h
    rule_in_words: Callable[[int, Array], str]  # what breaks a row of them at base translations (n,) [m]

    @classmethod
    def of(cls, scenario: Scenario) -> JointSpace:
        """The joint space of a scenario's robot, weighted as its cost says."""
        return cls.of_robot(scenario.robot, scenario.cost.mm_per_rad)

    @classmethod
    def of_robot(cls, robot: Robot, mm_per_rad: float = MM_PER_RAD) -> JointSpace:
        """The joint space of a robot, 1 rad counted as `mm_per_rad`."""
        G, h = reach_inequalities(robot.tubes)
        weights_mm = np.where(robot.drive.is_rotation, mm_per_rad, MM_PER_M)
        return cls(robot.drive, weights_mm, G, h, partial(nesting_sentence, robot))

    def difference(self, a: Array, b: Array) -> Array:
        """(m,) motion from a to b; unlimited rotations take the shorter way."""
        delta = b - a
        turns = np.round(delta / (2 * math.pi))
        shortest: Array = np.where(self.drive.wraps, delta - 2 * math.pi * turns, delta)
        return shortest

    def length_mm(self, delta: Array) -> float:
        """Weighted length of a motion by delta (m,): rotations and translations are each Euclidean, and add up.

        It is the same whether they move one after the other or together.
        """
        rotation = self.drive.is_rotation
        weighted = delta * self.weights_mm
        return float(np.linalg.norm(weighted[rotation]) + np.linalg.norm(weighted[~rotation]))

    def lengths_mm(self, delta: Array) -> Array:
        """(K,) the same of motions (K, m)."""
        rotation, weighted = self.drive.is_rotation, delta * self.weights_mm
        lengths: Array = np.linalg.norm(weighted[:, rotation], axis=1) + np.linalg.norm(weighted[:, ~rotation], axis=1)
        return lengths

    def legs(self, delta: Array) -> NDArray[np.int_]:
        """(K,) legs of the L-shaped motions by delta (K, m): 0, 1 or 2."""
        moves, rotation = delta != 0, self.drive.is_rotation
        count: NDArray[np.int_] = np.any(moves[:, rotation], axis=1).astype(int) + np.any(moves[:, ~rotation], axis=1)
        return count

    def corners(self, a: Array, b: Array, style: MotionStyle) -> Array:
        """(K, m) start, corner if both kinds of joints move, end; windings continue from a."""
        delta = self.difference(a, b)
        rotation = np.where(self.drive.is_rotation, delta, 0)
        if style == "simultaneous" or not rotation.any() or np.array_equal(rotation, delta):
            return np.array([a, a + delta])
        return np.array([a, a + rotation, a + delta])

    def straight_steps(self, way: Array) -> Array:
        """(S', m) joint values of a way (S, m) between which the drive's collars may be taken to move straight."""
        if not self.drive.terms:
            return way
        most = np.where(self.drive.is_rotation, BENT_STEP_RAD, BENT_STEP_M)
        parts = [way[:1]]
        for a, b in itertools.pairwise(way):
            count = max(1, int(np.ceil(np.max(np.abs(b - a) / most))))
            parts.append(a + np.linspace(0, 1, count + 1)[1:, None] * (b - a))
        return bent_steps(np.concatenate(parts), self.drive.collars, self.drive.bends)

    def allowed(self, q: ArrayLike) -> bool:
        """Whether limits and nesting hold at q (m,) or at every row of q (K, m)."""
        return bool(np.all(self.allowed_rows(np.atleast_2d(numbers(q, "joint values")))))

    def allowed_rows(self, q: Array) -> NDArray[np.bool_]:
        """(K,) whether limits and nesting hold at each row of q (K, m)."""
        within = np.all((q >= self.drive.lower - 1e-9) & (q <= self.drive.upper + 1e-9), axis=1)
        _, l_b = self.drive.collars(q)
        rows: NDArray[np.bool_] = within & np.all(l_b @ self.nesting_G.T <= self.nesting_h + ROUNDING_M, axis=1)
        return rows

    def violation(self, q: Array) -> str:
        """Sentence about joint values (m,), or about the first row of (K, m), that break a limit or the nesting."""
        rows = np.atleast_2d(q)
        row = int(np.argmin(self.allowed_rows(rows)))
        where, values = f"row {row}: " if len(rows) > 1 else "", rows[row]
        if not np.isfinite(values).all():
            return f"{where}joint values must be finite"
        outside = (values < self.drive.lower - 1e-9) | (values > self.drive.upper + 1e-9)
        if not outside.any():
            return f"{where}the tubes are not nested: {self._unnested(values)}"
        joint = self.drive.joints[int(np.argmax(outside))]
        value, low, high = (x / joint.si_per_unit for x in (values[outside][0], joint.lower, joint.upper))
        return f"{where}{joint.name} = {value:g} {joint.unit}: must be within {low:g} and {high:g} {joint.unit}"

    def _unnested(self, values: Array) -> str:
        """Which tubes do not nest at joint values (m,), by the worst rule of `reach_inequalities`."""
        l_b = self.drive.collars(values[None])[1][0]
        rule = int(np.argmax(self.nesting_G @ l_b - self.nesting_h))
        if rule == len(self.nesting_h) - 1:
            return "tube 1 is drawn back to the plate, so that nothing of it is in front"
        return self.rule_in_words(rule, l_b)

    def projected(self, q: Array, fallback: Array) -> Array:
        """q (K, m) moved into limits and nesting, by turns; rows of `fallback` where that did not succeed."""
        (slope, room), moves = self.nesting_rules, q.copy()
        norms = np.sum(slope**2, axis=1)
        for _ in range(PROJECTIONS):
            moves = np.clip(moves, self.drive.lower, self.drive.upper)
            if np.all(moves @ slope.T <= room + ROUNDING_M):
                break
            for row, limit, norm in zip(slope, room, norms, strict=True):
                moves -= np.maximum(moves @ row - limit, 0.0)[:, None] * row / norm
        return np.where(self.allowed_rows(moves)[:, None], moves, fallback)

    @cached_property
    def nesting_rules(self) -> tuple[Array, Array]:
        """A (r, m) and b (r,): joint values nest the tubes where A @ q <= b; rules that no joint touches left out.

        With effects of the drive that are not linear, at joint values near zero.
        """
        zero = np.zeros((1, len(self.drive.joints)))
        l_by_joints = self.drive.collars_by_joints(zero)[0, len(self.drive.home_l_m) :]
        slope = self.nesting_G @ l_by_joints
        touched = np.any(slope != 0, axis=1)
        room = self.nesting_h - self.nesting_G @ self.drive.collars(zero)[1][0]
        return read_only(slope[touched]), read_only(room[touched])

    def wound_into_limits(self, q: Array) -> Array:
        """q (K, m) with rotations taken by whole turns to where they are nearest to the middle of their range.

        Of rotations whose turns count only those with limits.
        """
        low, high = self._ranges()
        turns = np.where(
            self.drive.is_rotation & (self.drive.wraps | ~self.drive.is_unlimited),
            np.round((q - (low + high) / 2) / (2 * math.pi)),
            0.0,
        )
        return np.asarray(q - 2 * math.pi * turns)

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """(count, m) joint vectors within limits, uniform, nested; unlimited rotations in (-pi, pi]."""
        low, high = self._ranges()
        results: list[Array] = []
        for _ in range(20):
            q = rng.uniform(low, high, (count, low.size))
            _, l_b = self.drive.collars(q)
            results.extend(q[np.all(l_b @ self.nesting_G.T <= self.nesting_h + ROUNDING_M, axis=1)])
            if len(results) >= count:
                break
        return np.array(results[:count]).reshape(-1, low.size)

    def _ranges(self) -> tuple[Array, Array]:
        """Limits (m,), (m,), of unlimited rotations -pi and pi."""
        unlimited = self.drive.is_unlimited
        return np.where(unlimited, -math.pi, self.drive.lower), np.where(unlimited, math.pi, self.drive.upper)


def bent_steps(
    way: Array,
    collars: Callable[[Array], tuple[Array, Array]],
    bends: Callable[[Array], Sequence[tuple[Array, Array]]],
) -> Array:
    """(S', m) rows of a way (S, m) with more between them, so that collars go straight however narrow an effect is.

    Where effects stop being smooth are rows; then steps are halved until collars between them stand on the chord.
    """
    places, steps = [np.arange(len(way), dtype=float)], np.diff(way, axis=0)
    long = np.abs(steps).max(axis=1)
    for number, (given, where) in enumerate(bends(way)):
        is_over = given[:, None] > where
        k, value = np.nonzero(is_over[:-1] != is_over[1:])
        low, high, rises = np.zeros(len(k)), np.ones(len(k)), is_over[k + 1, value]
        while len(k) and ((high - low) * long[k]).max() > JOINT_ROUNDING:
            middle = (low + high) / 2
            is_past = (bends(way[k] + middle[:, None] * steps[k])[number][0] > where[value]) == rises
            low, high = np.where(is_past, low, middle), np.where(is_past, middle, high)
        places.append((k + high)[np.minimum(low, 1 - high) * long[k] > JOINT_ROUNDING])
    at = np.unique(np.concatenate(places))
    rows = np.array([np.interp(at, places[0], column) for column in way.T]).T
    while True:
        begin, end = rows[:-1], rows[1:]
        stand = np.hstack(collars(rows))
        size = np.repeat([BENT_STEP_RAD, BENT_STEP_M], stand.shape[1] // 2)
        off = [
            np.abs(np.hstack(collars(begin + share * (end - begin))) - stand[:-1] - share * np.diff(stand, axis=0))
            for share in (0.25, 0.5, 0.75)
        ]
        is_bowed = (np.max(off, axis=0) / size > BOW).any(axis=1) & (np.abs(end - begin).max(axis=1) > JOINT_ROUNDING)
        if not is_bowed.any():
            return rows
        rows = np.insert(rows, np.flatnonzero(is_bowed) + 1, (begin + end)[is_bowed] / 2, axis=0)


@checked(scenario=Made("Scenario"))
def l_shaped(path: ArrayLike, scenario: Scenario) -> Array:
    """(L, m) corners of the L-shaped motions through the states of path (K, m), rotations before translations.

    For planners whose edges are priced by `BoundObjective`: unlimited rotations take the shorter way, as the objective
    assumes; hand the result to `ctrplan.reorder`. Raises InputError for a path of another shape.
    """
    states, m = numbers(path, "path").copy(), len(scenario.robot.drive.joints)
    if states.ndim != 2 or states.shape[1] != m or not len(states) or not np.all(np.isfinite(states)):
        raise InputError(f"must be finite, of shape (K, {m}) with K >= 1, not {states.shape}", key="path")
    scenario.robot.drive.warn_of_degrees("path", states)
    space = JointSpace.of(scenario)
    corners = [states[0]]
    for target in states[1:]:
        corners.extend(space.corners(corners[-1], target, "rotations before translations")[1:])
    return np.array(corners)


def bare_scenario(robot: Robot) -> Scenario:
    """The robot in free space, its frame the anatomy's frame; the goal is the start."""
    space, drive = JointSpace.of_robot(robot), robot.drive
    zero = np.clip(np.zeros(len(drive.joints)), drive.lower, drive.upper)
    start = space.projected(zero[None], fallback=zero[None])[0]
    if not space.allowed(start):  # `never_nests` found values; random ones find them too
        drawn = space.sample(np.random.default_rng(0), 1)
        if not len(drawn):
            raise InputError("no joint values were found that nest the tubes", file=robot.path)
        start = drawn[0]
    return Scenario(
        name=robot.name,
        robot=robot,
        base_position_m=np.zeros(3),
        base_R=np.eye(3),
        start=start,
        goal=Goal(joints=start, tip_m=None, tolerance_m=1e-3),
        planner=CATALOGUE[DEFAULT](),  # type: ignore[call-arg]  # every setting has a default
        path=robot.path,
        warnings=robot.warnings,
    )


TURNS_RAD = (0.0, math.pi / 2, math.pi, -math.pi / 2)
MOST_JOINTS = 6  # whose turns are tried in all combinations


def retracted(robot: Robot) -> Array:
    """(m,) joint values: every translation at the end that draws tubes back, rotations where stability is greatest.

    Raises InputError where there is none within limits that nests and is stable: then the start has to be said.
    """
    space = JointSpace.of_robot(robot)
    tried = space.projected(_combinations(robot.drive), fallback=np.clip(0.0, robot.drive.lower, robot.drive.upper))
    tried = tried[space.allowed_rows(tried)]
    if len(tried):
        solved = robot.mechanics.bound_many(*robot.drive.collars(tried))
        sound = (solved.stability >= Margins.stability) & (solved.max_strain <= Margins.max_strain)
        if sound.any():
            return np.asarray(tried[np.argmax(np.where(sound, solved.stability, -np.inf))])
    raise InputError("drawn back the robot is not stable within limits: a start has to be said", file=robot.path)


TERM_STEP_MM = 1.0  # of joint length between states at which terms of the cost are asked for


def terms_mm(scenario: Scenario, corners: Array) -> tuple[float, ...]:
    """What a scenario's own terms cost on a polyline (K, m), valid or not; a state alone costs nothing."""
    terms, mm_per_rad = scenario.terms, scenario.cost.mm_per_rad
    if not terms or len(corners) == 1:
        return (0.0,) * len(terms)
    lengths = JointSpace.of(scenario).lengths_mm(np.diff(corners, axis=0))
    steps = np.maximum(1, np.ceil(lengths / TERM_STEP_MM).astype(int))
    corner = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.arange(corner[-1] + 1)
    states = np.column_stack([np.interp(at, corner, joint) for joint in corners.T])
    travelled = np.interp(at, corner, np.concatenate([[0.0], np.cumsum(lengths)]))
    return tuple(term.weight * float(np.trapezoid(_values_of(term, states), travelled)) / mm_per_rad for term in terms)


def _values_of(term: CostTerm, states: Array) -> Array:
    """(K,) of a term at states (K, m), which it may read. Raises InputError for wrong values, UserFunctionError."""
    file = getattr(getattr(term.of_states, "__code__", None), "co_filename", "")
    with of_the_user(f"term {term.name}", file):
        given = term.of_states(to_be_read(states))
    values = numbers(given, f"term {term.name}")
    if values.shape != (len(states),) or not np.isfinite(values).all() or values.min(initial=0.0) < 0:
        rule = f"must be {len(states)} finite numbers, one a state, zero or more"
        raise InputError(rule, key=f"term {term.name}", value=values if values.size else ...)
    return values


def check_terms(scenario: Scenario) -> None:
    """Raises InputError for a term of the cost that says another thing of the same state when it is asked again."""
    for term in scenario.terms:
        first, again = (_values_of(term, scenario.start[None])[0] for _ in range(2))
        if first != again:
            rule = f"must be a function of the states: of one state it says {first:g}, then {again:g}"
            raise InputError(rule, key=f"term {term.name}")


def _combinations(drive: Drive) -> Array:
    """(K, m) joint values; the first rotation stays at 0, since only turns against each other matter."""
    back = _backwards(drive)
    turning = np.flatnonzero(drive.is_rotation)[1 : 1 + MOST_JOINTS]
    rows = []
    for turns in itertools.product(TURNS_RAD, repeat=len(turning)):
        q = back.copy()
        q[turning] = turns
        rows.append(np.clip(q, drive.lower, drive.upper))
    return np.array(rows)


def _backwards(drive: Drive) -> Array:
    """(m,) with every translation at its limit that brings tubes back; at 0 where it has none."""
    q = np.zeros(len(drive.joints))
    for k in np.flatnonzero(~drive.is_rotation):
        unit = np.zeros_like(q)
        unit[k] = 1.0
        _, moved = drive.collars(unit)
        _, still = drive.collars(np.zeros_like(q))
        end = drive.lower[k] if np.sum(moved - still) > 0 else drive.upper[k]
        q[k] = end if math.isfinite(end) else 0.0
    return q
