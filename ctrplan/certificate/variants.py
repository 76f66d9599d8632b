"""What a robot may be besides what its file says: a box, its sides the stated intervals of parameters and the play of
the drive.

An axis of the box is a number s from -1 to 1. The robot of a point of the box and its collars there are solved as the
file's own. What is large bends, and is looked at together with friction in cells (`every_state.py`). What is small is
first order: a body point moves with every small axis by as much as it does from the middle of the box to the end of
that axis, and these lengths are added up. They are not projected on the way to the anatomy: points came up to 0.35 mm
nearer than that says. The base, of which only a ball of positions and rotations is known, moves points as a rigid body.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, alike, lengths, shares_of_length
from ctrplan.certificate.friction_cube import MOST_TUBES
from ctrplan.certificate.friction_states import (
    LOOK_EVERY,
    POINT_SPACING_M,
    SPACING_M,
    corner_states,
    signed_square,
    tips_at,
)
from ctrplan.drive.drive import JOINT_ROUNDING
from ctrplan.effects.learned.learned import effect_of
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity, PathSamples
from ctrplan.pipeline.tip_table import held
from ctrplan.scenario.joint_space import JointSpace, bent_steps
from ctrplan.uncertainty.parameters import UncertainParameters, uncertain_parameters
from ctrplan.uncertainty.tip_slopes import friction_states, widest_play
from ctrplan.uncertainty.worst_case import BaseBall, IntervalSides, OffsetBox, farthest

if TYPE_CHECKING:
    from ctrplan.mechanics.friction import FrictionStates
    from ctrplan.mechanics.shapes import Accuracy
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

# What moves the tip less than that is first order: of second order is a tenth of it at most, and the corners of all
# small axes together are solved where the anatomy is nearest.
LARGE_M = 0.2e-3
# Axes in cells, a budget: each doubles a sample's solves. At first, and where lengths of small ones may refuse a path.
MOST_LARGE = (2, 3)
PLACES = 5  # of the path where axes are ranked, its ends among them

Point = tuple[float, ...]  # of the box, one number an axis


@dataclass(frozen=True, eq=False)
class Variants:
    """The box of a scenario's robot, axes of its parameters first, of collars with play, of delays. Mostly empty."""

    scenario: Scenario
    parameters: UncertainParameters
    box: OffsetBox
    play: tuple[Array, ...]  # (2 G n,) each: rotations [rad] and translations [m] of one collar at one place of play
    late: tuple[Array, ...]  # (m,) each: how far one joint [rad or m] may be behind or ahead
    large: tuple[int, ...] = ()  # axes that are looked at in cells
    _robots: dict[bytes, Robot] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, scenario: Scenario, joints: Array, large: tuple[int, ...] | None = None, most: int = MOST_LARGE[0]
    ) -> Variants:
        """The box of a scenario's robot on a path along joints (K, m).

        Axes are large where they move the tip by more than LARGE_M on it, `most` at most, unless it is said which are.
        """
        robot, parameters = scenario.robot, uncertain_parameters(scenario.robot)
        play, late = (tuple(r for r in np.diag(by) if r.any()) for by in (widest_play(parameters), _late_by(robot)))
        box = OffsetBox.of(parameters) if parameters.count else OffsetBox(np.zeros(0), np.zeros((0, 0)))
        result = cls(scenario, parameters, box, play, late, large or ())
        if not result.count or large is not None:
            return result
        ways = result.straight_steps(joints)
        places = np.unique(np.linspace(0, len(ways) - 1, PLACES).round().astype(int))
        aside = result.moved_collars(ways)
        between = aside.max(axis=0) > aside[places].max(axis=0) + JOINT_ROUNDING  # where a term may act alone
        moved_m = result.tip_moves(ways[np.union1d(places, aside.argmax(axis=0)[between])])
        order = np.argsort(-moved_m, kind="stable")[: max(0, min(most, MOST_TUBES - robot.n))]
        return cls(scenario, parameters, box, play, late, tuple(sorted(int(k) for k in order if moved_m[k] > LARGE_M)))

    @property
    def count(self) -> int:
        """Number of axes."""
        return self.of_parameters + len(self.play) + len(self.late)

    @property
    def of_parameters(self) -> int:
        """Number of axes that are the parameters'; the others are the play's and the delays'."""
        return int(self.box.axes.shape[1])

    @property
    def small(self) -> tuple[int, ...]:
        """Axes that are first order."""
        return tuple(k for k in range(self.count) if k not in self.large)

    @property
    def has_middle(self) -> bool:
        """Whether the file's robot is the middle of the box."""
        return not self.box.middle.any()

    def title(self, axis: int) -> str:
        """What people call it: of correlated parameters all that it moves."""
        if axis >= self.of_parameters:
            return "play and delay of the drive"
        moved = np.flatnonzero(self.box.axes[:, axis])
        return " with ".join(dict.fromkeys(self.parameters.title[int(k)] for k in moved))

    @property
    def base(self) -> BaseBall:
        """Where the base may stand instead."""
        given = self.scenario.registration
        return BaseBall.of(given.position_sigma_m, given.rotation_sigma_rad)

    def end(self, axis: int, s: float = 1.0) -> Point:
        """The point at s of one axis, in the middle of the others."""
        return tuple(s if k == axis else 0.0 for k in range(self.count))

    @property
    def single(self) -> list[Point]:
        """The middle, and both ends of every axis."""
        return [self.end(-1), *(self.end(axis, side) for axis in range(self.count) for side in (1.0, -1.0))]

    def ends(self) -> list[Point]:
        """Both ends of every axis, and the corners of the large ones."""
        return list(
            dict.fromkeys([*self.single[1:], *(self.at(s) for s in corner_states(len(self.large)) if self.large)])
        )

    def at(self, s: Sequence[float]) -> Point:
        """The point at s (A,) of the large axes, in the middle of the small ones."""
        result = [0.0] * self.count
        for axis, value in zip(self.large, s, strict=True):
            result[axis] = value
        return tuple(result)

    def robot(self, point: Point) -> Robot:
        """The robot with its parameters there."""
        if not self.parameters.count:
            return self.scenario.robot
        offset = self.box.middle + self.box.axes @ np.array(point[: self.of_parameters])
        key = offset.tobytes()
        if key not in self._robots:
            self._robots[key] = self.parameters.robot_at(offset) if offset.any() else self.scenario.robot
        return self._robots[key]

    def collars(self, point: Point, joints: Array) -> tuple[Array, Array]:
        """(K, n) [rad], (K, n) [m] where the drive may hold collars there, joints (K, m) driven; nested."""
        q, off = self._driven(point, joints)
        return held(self.robot(point), *self.scenario.robot.drive.commanded(q), off)

    def _driven(self, point: Point, joints: Array) -> tuple[Array, Array | None]:
        """Where joints (K, m) are there, on their path, which keeps the limits, and how far off by play (2 G n,)."""
        drive = self.scenario.robot.drive
        if self.late:
            behind = np.array(self.late).T @ np.array(point[-len(self.late) :])
            joints = np.clip(joints + behind, drive.lower, drive.upper)
        sides = zip(point[self.of_parameters :], self.play, strict=False)
        return joints, np.sum([s * row for s, row in sides], axis=0) if self.play else None

    def straight_steps(self, way: Array) -> Array:
        """(S', m) joint values of a way (S, m) between which collars go straight, at the ends of the box as well."""
        rows = JointSpace.of_robot(self.scenario.robot).straight_steps(way)
        for point in self.ends() if self.scenario.robot.drive.terms else ():
            rows = bent_steps(rows, partial(self.collars, point), partial(self._bends, point))
        return rows

    def _bends(self, point: Point, joints: Array) -> list[tuple[Array, Array]]:
        return self.robot(point).drive.bends(*self._driven(point, joints))

    def unseen(self, joints: Array, aside: Array) -> str:
        """Why ends of axes say too little of what lies between at joints (K, m), where they move collars `aside`."""
        for (given, where), *ends in zip(*(self._bends(point, joints) for point in self.single), strict=True):
            off = np.abs([end - given for end, _ in ends]).reshape(-1, 2, len(given)).max(axis=1).sum(axis=0)
            if ((np.abs(where - given[:, None]) < off[:, None]).sum(axis=1) > 1).any():
                return FINER_THAN_KNOWN
        turned = aside.reshape(len(joints), -1, self.scenario.robot.n)[:, ::2]  # from half a turn on it comes back
        return HALF_TURN if turned.max() >= np.pi else ""

    def moved_collars(self, joints: Array) -> Array:
        """(K, C) [rad], [m] how far either end of each axis moves each collar at joints (K, m) driven."""
        middle, *ends = (np.hstack(self.collars(point, joints)) for point in self.single)
        return np.abs(np.hstack([end - middle for end in ends]))

    def configuration(self, point: Point, joints: Array, accuracy: Accuracy) -> FrictionStates:
        """Friction states of the variant at joints (m,). Raises the errors of the mechanics."""
        theta_b, l_b = self.collars(point, joints[None])
        return self.robot(point).mechanics.friction_states(theta_b[0], l_b[0], accuracy=accuracy)

    def tip_moves(self, joints: Array) -> Array:
        """(A,) [m] largest displacement of the frictionless tip by either half of each axis; inf where it is lost."""
        middle = self._tips(self.end(-1), joints)
        ends = [[self._tips(self.end(axis, side), joints) for side in (1.0, -1.0)] for axis in range(self.count)]
        moved = np.array([[lengths(tips - middle).max() for tips in of_axis] for of_axis in ends]).reshape(-1, 2)
        return np.asarray(np.nan_to_num(moved, nan=np.inf).max(axis=1))

    def _tips(self, point: Point, joints: Array) -> Array:
        """(K, 3); NaN without an equilibrium."""
        robot = self.robot(point)
        tips = robot.mechanics.tips_with_friction(*self.collars(point, joints), np.zeros((len(joints), robot.n - 1)))
        return np.where((tips.status == Status.FAILED)[:, None], np.nan, tips.position_m)


def _late_by(robot: Robot) -> Array:
    """(m,) [rad or m] how far joints may be off where delays are intervals: at their largest speed, everywhere."""
    drive, delay_s = robot.drive, np.zeros(len(robot.drive.joints))
    moves = np.vstack([drive.matrix_theta, drive.matrix_l]) != 0
    for name, table in robot.effects.items():
        effect = effect_of(name, table, robot.n)
        for key, (low, high) in table.get("ci95", {}).items() if effect.stage == "clock" else ():
            value = float(table.get(key, 0.0))
            of_collars = effect.drive_delays_s({key: max(high - value, value - low)}, robot.n)
            delay_s += np.where(moves, of_collars[:, None], 0.0).max(axis=0)
    return np.asarray(delay_s * drive.max_velocity)


# A variant is walked along the samples of the file's robot; more are taken where it moves farther between them.
VARIANT_SPACING_M = 1.5 * SPACING_M
FINER_THAN_KNOWN = "an effect of the drive changes within less than play, delay and intervals before it"
HALF_TURN = "play, delay or an interval may turn a tube by half a turn either way"
NO_EQUILIBRIUM = "a robot that the stated intervals and play allow has no equilibrium, or snaps"


@dataclass(frozen=True, eq=False)
class VariantWalks:
    """What was walked of a box along K samples of a path, beside the file's robot."""

    corners: tuple[PathSamples, ...] = ()  # K rows each: corners of the large axes in the order of `corner_states`
    reach_m: tuple[Array, ...] = ()  # per sample (N,): how far small axes and base move its points; empty if not
    bound_m: Array | None = None  # (K,) what parameters add to the bound of the tip; None without them
    play_m: Array | None = None  # (K,) how far play moves the tip, every collar's added up
    softer: Array | None = None  # (K,) what small axes take off the square of the stability
    end_tips_m: tuple[Array, Array] | None = None  # (T, 3) each: tips of all ends of single axes, at the first and last
    strain: Array | None = None  # (K,) and add to the strain
    fault: str = ""  # why it could not be walked


def walk_corners(variants: Variants, joints: Array, accuracy: Accuracy) -> tuple[list[PathSamples], Array]:
    """Corners of the large axes walked along joints (K, m), and the (L, m) samples that they need, these among them."""
    density = PathDensity(motion_m=VARIANT_SPACING_M, near_m=VARIANT_SPACING_M, point_spacing_m=POINT_SPACING_M)
    points = [variants.at(s) for s in corner_states(len(variants.large))]
    walks = [_walked(variants, point, joints, density, accuracy) for point in points]
    places = np.unique(np.concatenate([np.arange(len(joints)), *(walk.segment + walk.fraction for walk in walks)]))
    rows = np.arange(len(joints))
    finer = np.array([np.interp(places, rows, column) for column in joints.T]).T
    return walks, finer


def walk_variants(
    variants: Variants,
    joints: Array,
    samples: PathSamples,
    nominal: Sequence[Array],
    corners: Sequence[PathSamples],
    accuracy: Accuracy,
) -> VariantWalks:
    """The box along joints (K, m), whose file's robot was walked: its samples, and its frictionless bodies (N, 3)."""
    count = len(joints)
    if not variants.count and variants.scenario.registration.is_exact:
        return VariantWalks()
    at_rows = [walk.at_given(count) for walk in corners]
    if any(walk is None for walk in at_rows):
        return VariantWalks(fault=NO_EQUILIBRIUM)
    base = variants.base
    reach = [np.full(len(body), base.shift_m) for body in nominal]
    result = VariantWalks(tuple(filter(None, at_rows)), tuple(reach))
    return _with_axes(variants, joints, samples, nominal, result, accuracy) if variants.count else result


def _with_axes(
    variants: Variants,
    joints: Array,
    samples: PathSamples,
    nominal: Sequence[Array],
    walks: VariantWalks,
    accuracy: Accuracy,
) -> VariantWalks:
    """The walks with what single axes do, each at its end, at every few samples and where one moves collars farther
    than at these.
    """
    count = len(joints)
    rows = np.unique(np.append(np.arange(0, count, LOOK_EVERY), count - 1))
    aside = variants.moved_collars(joints)
    if fault := variants.unseen(joints, aside):
        return replace(walks, fault=fault)
    rows = np.union1d(rows, np.flatnonzero((aside > _larger(rows, aside[rows], count) + JOINT_ROUNDING).any(axis=1)))
    coarse_m = 2 * LOOK_EVERY * SPACING_M
    density = PathDensity(motion_m=coarse_m, near_m=coarse_m, point_spacing_m=POINT_SPACING_M)
    middle: PathSamples | None = samples.at_rows(rows)
    if not variants.has_middle:
        middle = _at_rows(variants, variants.end(-1), joints[rows], density, accuracy)
    single = {k: _at_rows(variants, variants.end(k), joints[rows], density, accuracy) for k in range(variants.count)}
    both = (*variants.large, *(k for k in variants.small if not _moves_evenly(variants, k, joints[rows])))
    other = {k: _at_rows(variants, variants.end(k, -1.0), joints[rows], density, accuracy) for k in both}
    if middle is None or any(walk is None for walk in [*single.values(), *other.values()]):
        return replace(walks, fault=NO_EQUILIBRIUM)
    shapes, squares = 1 + 2 ** (variants.scenario.robot.n - 1), signed_square(middle.shape_stability)
    moved = [np.zeros(len(nominal[row])) for row in rows]
    play, softer, strain = (np.zeros(len(rows)) for _ in range(3))
    for k, walk in single.items():
        assert walk is not None
        sides = [walk, back] if (back := other.get(k)) else [walk]
        if k >= variants.of_parameters:
            play += np.max([lengths(side.tip_m - middle.tip_m) for side in sides], axis=0)
        if k in variants.large:
            continue
        softer += np.max([np.abs(signed_square(s.shape_stability) - squares).max(axis=1) for s in sides], axis=0)
        strain += np.max([np.abs(s.shape_max_strain - middle.shape_max_strain).max(axis=1) for s in sides], axis=0)
        for j, row in enumerate(rows):
            here = _points(middle, j, shapes, nominal[row])
            off = [lengths(_points(side, j, shapes, nominal[row]) - here) for side in sides]
            moved[j] += np.max(off, axis=(0, 1))
    if not variants.has_middle:  # the small axes are counted from the middle, the file's robot lies beside it
        softer += np.abs(squares - signed_square(samples.shape_stability[rows])).max(axis=1)
        strain += np.abs(middle.shape_max_strain - samples.shape_max_strain[rows]).max(axis=1)
        for j, row in enumerate(rows):
            off = _points(middle, j, shapes, nominal[row])[0] - nominal[row]
            moved[j] += 0.0 if variants.large else lengths(off)
    reach = [own_m + between for own_m, between in zip(walks.reach_m, _between(rows, moved, nominal), strict=True)]
    every, spread = np.arange(count), [_larger(rows, values, count) for values in (softer, strain)]
    ends = [walk for walk in [*single.values(), *other.values()] if walk]
    if variants.small:
        by = {k: signed_square(single[k].shape_stability) - squares for k in variants.small}  # type: ignore[union-attr]
        solved = [signed_square(walk.shape_stability[rows]) for walk in (samples, *walks.corners)]
        softest = _at_rows(variants, _softest(variants, solved, by), joints[rows], density, accuracy)
        if softest is None:
            return replace(walks, fault=NO_EQUILIBRIUM)
        least = np.min(solved, axis=(0, 2))
        softer = np.maximum(softer, least - signed_square(softest.shape_stability).min(axis=1))
    bound = None
    if variants.of_parameters:
        of_rows = replace(samples.at_rows(rows), bodies=())
        ends_of = [(walk, other.get(k)) for k, walk in single.items() if walk and k < variants.of_parameters]
        bound = _larger(rows, _wider_bounds(variants, joints[rows], of_rows, middle, ends_of, accuracy), count)
    return replace(
        walks,
        reach_m=tuple(reach),
        bound_m=bound,
        play_m=np.interp(every, rows, play) if variants.count > variants.of_parameters else None,
        softer=spread[0],
        end_tips_m=(tips_at(ends, 0), tips_at(ends, -1)),
        strain=spread[1],
    )


def _moves_evenly(variants: Variants, axis: int, joints: Array) -> bool:
    """Whether collars at both ends of an axis stand as far from the middle: not where a limit or a nested tube stops
    them, or where an effect of the drive is not linear.
    """
    middle, *ends = (
        np.hstack(variants.collars(variants.end(k, s), joints)) for k, s in ((-1, 0), (axis, 1), (axis, -1))
    )
    return bool(np.allclose(ends[0] - middle, middle - ends[1], rtol=0.0, atol=JOINT_ROUNDING))


def _softest(variants: Variants, squares: Sequence[Array], by: Mapping[int, Array]) -> Point:
    """The corner of the box that is nearest to a fold, to first order.

    squares: of stabilities (R, 1 + C) of the file's robot and of the corners of the large axes; by: what each small
    axis adds to them.
    """
    left = [each - np.sum([np.abs(change) for change in by.values()], axis=0) for each in squares]
    walk, row, shape = np.unravel_index(np.argmin(left), np.shape(left))
    large = corner_states(len(variants.large))[int(walk) - 1] if variants.large else ()
    point = list(variants.at(large))
    for axis, change in by.items():
        point[axis] = -1.0 if change[row, shape] > 0 else 1.0
    return tuple(point)


def _wider_bounds(
    variants: Variants,
    joints: Array,
    own: PathSamples,
    middle: PathSamples,
    ends: Sequence[tuple[PathSamples, PathSamples | None]],
    accuracy: Accuracy,
) -> Array:
    """(K,) [m] what parameters add to the bound at joints (K, m): how much farther corners' tips may come from the
    tip that the file's robot has without friction. First order, by the walks of both ends of an axis where there are
    two, and what the worst combinations differ by, solved.
    """

    def tips_of(walk: PathSamples) -> Array:
        return np.concatenate([walk.tip_m[:, None], walk.corner_tip_m], axis=1)

    start, centre = tips_of(own), tips_of(middle)
    count, states = start.shape[:2]
    away = (start - start[:, :1]).reshape(-1, 3)
    wider, beyond = np.zeros(count), 0.0
    above = [tips_of(end) - centre for end, _ in ends]
    below = [centre - tips_of(back) if back else up for (_, back), up in zip(ends, above, strict=True)]
    for moved in (above, below) if any(back for _, back in ends) else (above,):
        sides = np.stack(moved, axis=3)
        result = farthest(away, IntervalSides((centre - start).reshape(-1, 3), sides.reshape(count * states, 3, -1)))
        length, signs = result.length_m.reshape(count, states), result.signs.reshape(count, states, -1)
        state, friction = np.argmax(length, axis=1), lengths(away).reshape(count, states).max(axis=1)
        wider = np.maximum(length.max(axis=1) - friction, wider)
        for k in {count - 1, int(np.argmax(wider))}:
            point = (*signs[k, state[k]].tolist(), *variants.end(-1)[variants.of_parameters :])
            robot, phi = variants.robot(point), friction_states(variants.scenario.robot)[state[k]]
            solved = robot.mechanics.tips_with_friction(
                *variants.collars(point, joints[k : k + 1]), phi[None], accuracy=accuracy
            )
            linear = centre[k, state[k]] + sides[k, state[k]] @ signs[k, state[k]]
            is_lost = solved.status[0] == Status.FAILED
            beyond = max(beyond, np.inf if is_lost else float(np.linalg.norm(solved.position_m[0] - linear)))
    return np.asarray(wider + beyond)


def _points(walk: PathSamples, row: int, shapes: int, pattern: Array) -> Array:
    """(1 + C, N, 3) bodies of a row of a walk, on as many points as the pattern (N, 3) has."""
    return alike(walk.bodies[row].reshape(shapes, -1, 4)[:, :, :3], pattern)


def _between(rows: NDArray[np.intp], moved: Sequence[Array], nominal: Sequence[Array]) -> list[Array]:
    """(N,) of every sample: the larger of the rows on both sides, at the same shares of the length."""
    results, right = [], np.searchsorted(rows, np.arange(len(nominal)))
    for k, body in enumerate(nominal):
        share, sides = shares_of_length(body), {int(right[k])} | ({int(right[k]) - 1} if rows[right[k]] != k else set())
        values = [np.interp(share, shares_of_length(nominal[rows[j]]), moved[j]) for j in sides]
        results.append(np.max(values, axis=0))
    return results


def _larger(rows: NDArray[np.intp], values: Array, count: int) -> Array:
    """(count,) values at `rows`; in between the larger of both sides."""
    right = np.searchsorted(rows, np.arange(count))
    left = np.where(rows[right] == np.arange(count), right, np.maximum(right - 1, 0))
    return np.asarray(np.maximum(values[left], values[right]))


def _at_rows(
    variants: Variants, point: Point, joints: Array, density: PathDensity, accuracy: Accuracy
) -> PathSamples | None:
    return _walked(variants, point, joints, density, accuracy).at_given(len(joints))


def _walked(variants: Variants, point: Point, joints: Array, density: PathDensity, accuracy: Accuracy) -> PathSamples:
    collars = variants.collars(point, joints)
    return variants.robot(point).mechanics.check_path(*collars, density=density, accuracy=accuracy, bodies=True)
