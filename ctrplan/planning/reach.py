"""Configurations that reach a tip target, with bound, stability and clearance, sorted into branches.

A branch is a connected piece of all configurations that reach the target: one of its own for each solution where the
drive has just enough joints, a curve or more where it has joints to spare.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import cores
from ctrplan.base.package import shown
from ctrplan.mechanics.friction import corner_signs
from ctrplan.mechanics.gradients import collar_names
from ctrplan.mechanics.shapes import Status, Tips
from ctrplan.mechanics.walk import PathSamples
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.play import play_shift
from ctrplan.scenario.tip_solver import TipSolver, TipTarget, angle_to, damped_steps, miss_of

if TYPE_CHECKING:
    from ctrplan.mechanics.core_arrays import Near
    from ctrplan.robot.robot import Robot


def tips_by_joints(checker: MotionChecker, q: Array, phi: Array, near: Near | None = None) -> Tips:
    """Tips at joint values q (K, m) in friction states phi (K, n - 1), with derivatives (K, 3, m) by rad or m.

    A joint at a limit of the tubes' nesting has no derivative and counts as fixed. near: known solutions, which those
    beside them begin from.
    """
    drive, names = checker.space.drive, collar_names(checker.mechanics.n)
    moves = drive.collars_by_joints(q)
    moved = np.flatnonzero(moves.any(axis=(0, 2))).tolist()
    parameters, moves = [names[k] for k in moved], moves[:, moved]
    tips = checker.mechanics.tips_with_friction(*drive.collars(q), phi, parameters=parameters, near=near)
    by_joints = (np.nan_to_num(slope) @ moves for slope in (tips.position_by, tips.tangent_by))
    return replace(tips, position_by=next(by_joints), tangent_by=next(by_joints))


@dataclass(frozen=True, eq=False)
class BoundSlopes:
    """How the bound and the frictionless tip of K configurations change with the joints."""

    bound_by: Array  # (K, m) [m per rad or m] of the corner whose tip is farthest from the frictionless one
    tip_m: Array  # (K, 3) frictionless, robot's frame
    tip_by: Array  # (K, 3, m)
    bound_m: Array  # (K,) the distance of those tips


def bound_slopes(checker: MotionChecker, q: Array) -> BoundSlopes:
    """Derivatives of the bound on the tip's position at q (K, m), zero where a solve failed."""
    pairs = checker.mechanics.n - 1
    states = np.vstack([np.zeros(pairs), corner_signs(pairs)])
    tips = tips_by_joints(checker, np.repeat(q, len(states), axis=0), np.tile(states, (len(q), 1)))
    checker.meter.add(checker.solved_ns * len(q))
    position = tips.position_m.reshape(len(q), len(states), 3)
    by = tips.position_by.reshape(len(q), len(states), 3, -1)
    away = np.nan_to_num(position[:, 1:] - position[:, :1])
    size = np.linalg.norm(away, axis=2)
    rows, farthest = np.arange(len(q)), np.argmax(size, axis=1)
    unit = away[rows, farthest] / np.maximum(size[rows, farthest], 1e-12)[:, None]
    bound_by = np.einsum("ki,kij->kj", unit, by[rows, 1 + farthest] - by[:, 0])
    return BoundSlopes(bound_by, position[:, 0], by[:, 0], size[rows, farthest])


SAMPLES = 1500  # random configurations whose tips are looked at
STARTS = 300  # of them, the nearest ones after a common rotation: solves
DISTINCT_MM = 5.0  # of joint length between configurations
MOST_REFINED = 80
ROOM_ENOUGH_M = 5e-3  # more than friction makes of most shapes
CLEARANCE_STEPS = 4  # on the frictionless clearance model; most configurations need one
SHORTER = 0.5  # a step after one that did not lead where it should
BEND_STEPS = 3  # within each: the bend of the zero-clearance model changes by a tenth or so of itself, and less again
GAP_M = 6e-3  # more than clearance moves a tip: within it of the target, refining on the clearance model pays
TURN_RAD = 0.1  # more than clearance turns a tangent
REFINED_SHARE = 0.2  # of the tolerance; half of it saved nothing and left goals 0.5 mm off
LINK_MM = 30.0  # of joint length between neighbours in a branch
SAME_SHARE = 0.35  # of their distance that the middle of two neighbours may lie off their branch


@shown
@dataclass(frozen=True, eq=False)
class Configuration:
    """Joint values at a target, and what they are worth with clearance and friction."""

    robot: Robot
    joints: Array  # (m,)
    tip_m: Array  # (3,) frictionless, robot's frame
    tangent: Array  # (3,)
    tip_error_m: float
    turned_rad: float  # of the tangent from the direction asked for
    bound_m: float
    bound_rad: float
    stability: float
    max_strain: float
    clearance_m: float  # of all shapes beyond the anatomy's margins; inf in free space
    reason: str  # why it is not valid; empty if it is

    @property
    def valid(self) -> bool:
        """Whether it keeps all limits and margins."""
        return not self.reason

    @cached_property
    def play_m(self) -> float:
        """How far play of the drive may move the tip besides; inf where the robot has no equilibrium at its ends."""
        return play_shift(self.robot, *self.robot.drive.commanded(self.joints))

    @property
    def worst_m(self) -> float:
        """The tip from the target at worst, whatever friction and play do."""
        return self.tip_error_m + self.bound_m + self.play_m

    @property
    def worst_rad(self) -> float:
        """The tangent from the direction asked for at worst, whatever friction does."""
        return self.turned_rad + self.bound_rad


@shown
@dataclass(frozen=True, eq=False)
class Reach:
    """What is known about reaching a target."""

    configurations: tuple[Configuration, ...]  # within the tolerances, lowest bound first
    nearest: Configuration  # the frictionless tip that came closest, whatever else it does
    tolerance_m: float
    direction_tolerance_rad: float
    solver: TipSolver
    target: TipTarget

    def branches(self) -> NDArray[np.int_]:
        """(K,) number of each configuration's branch, counted from 0 in the order of their best bounds."""
        return _branches(self.solver, self.target, np.array([c.joints for c in self.configurations]))


def reach(
    checker: MotionChecker,
    target: TipTarget,
    tolerance_m: float,
    rng: np.random.Generator,
    starts: int = STARTS,
    *,
    least_room_m: float = -np.inf,
) -> Reach:
    """Distinct configurations whose frictionless tip is within `tolerance_m` of the target, from random starts.

    Where the zero-clearance shapes of some keep `least_room_m` to the anatomy, the others are not looked at.
    """
    solver = TipSolver(checker.space, checker.mechanics)
    begin, aim = _starts(solver, target, rng, starts), target
    q = solver.solve(aim, begin)
    if not q.reached(replace(target, direction_tolerance_rad=target.direction_tolerance_rad + TURN_RAD), GAP_M).any():
        aim = TipTarget(target.tip_m)  # the direction can't be had there: how near does the position come?
        q = solver.solve(aim, begin)
    order = np.argsort(q.error_m)
    near = order[q.error_m[order] <= tolerance_m + GAP_M]
    near = _by_room(checker, q.joints, near, least_room_m) if len(near) else order[:1]
    chosen = distinct_rows(checker, q.joints, near, MOST_REFINED)
    joints = refined(checker, aim, q.joints[chosen], tolerance_m)
    _probed(checker, joints)
    results = [configuration(checker, target, joint) for joint in joints]
    nearest = min(results, key=lambda c: c.tip_error_m)
    reached = [c for c in results if c.tip_error_m <= tolerance_m and c.turned_rad <= target.direction_tolerance_rad]
    reached.sort(key=lambda c: c.bound_m)
    kept = distinct_rows(checker, np.array([c.joints for c in reached]), np.arange(len(reached)))
    return Reach(tuple(reached[k] for k in kept), nearest, tolerance_m, target.direction_tolerance_rad, solver, target)


def _starts(solver: TipSolver, target: TipTarget, rng: np.random.Generator, count: int) -> Array:
    """The `count` of many random configurations whose tips come nearest when all tubes may turn together."""
    q = solver.space.sample(rng, max(SAMPLES, 2 * count))
    tip, tangent = solver.tips(q)
    goal = np.broadcast_to(target.tip_m, tip.shape)
    if solver.common_rotation is None:
        miss = np.linalg.norm(goal - tip, axis=1)
    else:
        miss = np.hypot(np.hypot(goal[:, 0], goal[:, 1]) - np.hypot(tip[:, 0], tip[:, 1]), goal[:, 2] - tip[:, 2])
    miss[np.isnan(miss)] = np.inf
    return q[np.argsort(miss)[:count]]


def _by_room(checker: MotionChecker, q: Array, rows: NDArray[np.int_], least_m: float) -> NDArray[np.int_]:
    """Rows of q (K, m) whose zero-clearance shapes keep `least_m` to the anatomy, or all if none does.

    Most room first; none counts as more than ROOM_ENOUGH_M.
    """
    if checker.field is None:
        return rows
    rooms = checker.mechanics.zero_clearance_rooms(*checker.space.drive.collars(q[rows]), checker.field)[0]
    kept = rooms >= least_m
    rows, rooms = (rows[kept], rooms[kept]) if kept.any() else (rows, rooms)
    return rows[np.argsort(-np.minimum(rooms, ROOM_ENOUGH_M), kind="stable")]


def distinct_rows(
    checker: MotionChecker, q: Array, order: NDArray[np.int_], most: int | None = None
) -> NDArray[np.int_]:
    """Members of `order` that are not within DISTINCT_MM of one before them, at most `most`."""
    kept: list[int] = []
    while len(order) and len(kept) != most:
        kept.append(int(order[0]))
        delta = checker.space.difference(q[order[0]], q[order[1:]])
        order = order[1:][np.linalg.norm(delta * checker.space.weights_mm, axis=1) > DISTINCT_MM]
    return np.array(kept, dtype=int)


def refined(checker: MotionChecker, target: TipTarget, q: Array, tolerance_m: float) -> Array:
    """Damped Newton steps on the frictionless tip with clearance, by exact derivatives; the best place of each.

    A step follows the derivatives and the bend that the zero-clearance model shows on the way: mostly one does. After
    one that led no nearer comes a shorter one, along the derivatives alone, and no other if that does not either.
    Derivatives are renewed where a step like the one before would not do. Where steps lead is probed, which the
    configuration there needs in any case; the tip alone is solved where another step is likely to follow, as the models
    part on the way by more than twice the tolerance.
    """
    solver = TipSolver(checker.space, checker.mechanics)
    best, share, aim_m = q.copy(), np.ones(len(q)), REFINED_SHARE * tolerance_m
    pose, slope = _pose_by_joints(checker, q)
    error = np.linalg.norm(miss_of(target, pose)[0], axis=1)
    for _ in range(CLEARANCE_STEPS):
        todo = np.flatnonzero((error > aim_m) & (share >= SHORTER))  # not where a solve failed
        if not len(todo):
            break
        here = best[todo]
        moved, part_m = _stepped(solver, target, here, pose[todo], slope[todo], share[todo] == 1)
        moved = checker.space.projected(here + share[todo, None] * (moved - here), fallback=here)
        there, is_likely_last = np.empty((len(todo), 6)), part_m <= 2 * tolerance_m
        there[is_likely_last] = _probed_pose(checker, moved[is_likely_last])
        there[~is_likely_last] = _pose(_frictionless_tips(checker, moved[~is_likely_last]))
        left = np.linalg.norm(miss_of(target, there)[0], axis=1)
        better = left < error[todo]
        share[todo] = np.where(better, 1.0, share[todo] * SHORTER)
        kept = todo[better]
        falls_short = kept[(left[better] > aim_m) & (left[better] ** 2 > aim_m * error[kept])]
        best[kept], pose[kept], error[kept] = moved[better], there[better], left[better]
        if len(falls_short):
            _, slope[falls_short] = _pose_by_joints(checker, best[falls_short])
    return best


def _pose_by_joints(checker: MotionChecker, q: Array) -> tuple[Array, Array]:
    """(K, 6) frictionless tips and tangents at q (K, m), and their derivatives by joints (K, 6, m).

    NaN where the solve failed; a joint at a limit of the tubes' nesting has no derivative and counts as fixed.
    """
    tips = tips_by_joints(checker, q, np.zeros((len(q), checker.mechanics.n - 1)))
    return _pose(tips), np.concatenate([tips.position_by, tips.tangent_by], axis=1)


def _pose(tips: Tips) -> Array:
    """(K, 6) tips and tangents; NaN where the solve failed."""
    pose = np.hstack([tips.position_m, tips.tangent])
    pose[tips.status == Status.FAILED] = np.nan
    return pose


def _frictionless_tips(checker: MotionChecker, q: Array) -> Tips:
    """Tips at q (K, m), without derivatives."""
    states = np.zeros((len(q), checker.mechanics.n - 1))
    return checker.mechanics.tips_with_friction(*checker.space.drive.collars(q), states)


def _probed_pose(checker: MotionChecker, q: Array) -> Array:
    """(K, 6) frictionless tips and tangents at q (K, m); NaN where the solve failed."""
    result = _probed(checker, q)
    pose = np.array([np.concatenate([s.tip_m[-1], s.tip_tangent[-1]]) for s in result]).reshape(-1, 6)
    pose[[samples.status[-1] == Status.FAILED for samples in result]] = np.nan
    return pose


def _stepped(
    solver: TipSolver, target: TipTarget, q: Array, pose: Array, slope: Array, bent: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """q (K, m) after least-squares steps, no longer than LONGEST_STEP_M of weighted joint length each.

    Poses (K, 6) are known at q, derivatives (K, 6, m) near there. Where `bent` (K,), the bend on the way is that of the
    zero-clearance model, none without a solution of it. And by how much (K,) [m] the derivatives of the two models part
    the tips on the way.
    """
    space, joints, here = solver.space, q, pose
    weights, (tip, tangent) = space.weights_mm / MM_PER_M, solver.tips(q)
    straight = solver.jacobian(q, tip, tangent)
    for _ in range(BEND_STEPS):
        miss, weight = miss_of(target, here)
        scaled = slope / weights
        scaled[:, 3:] *= weight[:, None, None]
        step = damped_steps(scaled, np.nan_to_num(miss))
        joints = space.projected(joints + step / weights, fallback=joints)
        moved = joints - q
        bend = np.hstack(solver.tips(joints)) - np.hstack([tip, tangent]) - _times(straight, moved)
        here = pose + _times(slope, moved) + np.where(bent[:, None], np.nan_to_num(bend), 0.0)
    return joints, np.linalg.norm(_times(slope - straight, moved)[:, :3], axis=1)


def _times(slope: Array, moved: Array) -> Array:
    """(K, 6) changes by joint motions (K, m) along derivatives (K, 6, m)."""
    return np.asarray(np.einsum("kij,kj->ki", slope, moved))


def _probed(checker: MotionChecker, q: Array) -> list[PathSamples]:
    """What the core says of configurations q (K, m), which the checker remembers."""

    def probe(joints: Array) -> PathSamples:
        _, samples = checker.probe(joints)
        assert samples is not None, "the solver keeps limits and nesting"
        return samples

    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(probe, q))


def configuration(checker: MotionChecker, target: TipTarget, joints: Array) -> Configuration:
    """Joint values (m,) and what they are worth at a target."""
    motion, samples = checker.probe(joints)
    assert samples is not None, "the solver keeps limits and nesting"
    tip, tangent = samples.tip_m[-1], samples.tip_tangent[-1]
    failed = samples.status[-1] == Status.FAILED
    return Configuration(
        robot=checker.scenario.robot,
        joints=joints,
        tip_m=tip,
        tangent=tangent,
        tip_error_m=np.inf if failed else float(np.linalg.norm(tip - target.tip_m)),
        turned_rad=float(angle_to(tangent[None], target.direction)[0]),
        bound_m=float(samples.position_m[-1]),
        bound_rad=float(samples.tangent_rad[-1]),
        stability=float(samples.stability[-1]),
        max_strain=float(samples.max_strain[-1]),
        clearance_m=float(samples.clearance_m[-1]) if checker.field else np.inf,
        reason=motion.reason,
    )


def _branches(solver: TipSolver, target: TipTarget, q: Array) -> NDArray[np.int_]:
    """Neighbours are linked when the configuration in their middle can be put back onto the target nearby.

    The nearest neighbours that would link all are tried first, then those that are not linked by others yet.
    """
    space, count = solver.space, len(q)
    if count < 2:
        return np.zeros(count, dtype=int)
    delta = space.difference(q[:, None], q[None])
    apart = np.linalg.norm(delta * space.weights_mm, axis=2)
    a, b = np.nonzero(np.triu(apart < LINK_MM, 1))
    middle = q[a] + delta[a, b] / 2
    kept = np.flatnonzero(space.allowed_rows(middle))
    untried = kept[np.argsort(apart[a[kept], b[kept]], kind="stable")]
    joins = _joining(count, a[untried], b[untried])
    untried, at_once = np.concatenate([untried[joins], untried[~joins]]), int(joins.sum())
    # each pair's own zero-clearance tips, which differ a little where the clearance tip is on the target
    tips, label = solver.tips(q)[0], np.arange(count)
    while len(untried := untried[label[a[untried]] != label[b[untried]]]):
        pairs, untried, at_once = untried[:at_once], untried[at_once:], 2 * at_once
        back = solver.solve(TipTarget((tips[a[pairs]] + tips[b[pairs]]) / 2), middle[pairs], 5, turned=False)
        off = np.linalg.norm(space.difference(middle[pairs], back.joints) * space.weights_mm, axis=1)
        linked = pairs[(back.error_m < 0.5e-3) & (off <= SAME_SHARE * apart[a[pairs], b[pairs]] + 1.0)]
        for pair in linked:
            ends = label[a[pair]], label[b[pair]]
            label[label == max(ends)] = min(ends)
    return np.unique(label, return_inverse=True)[1]


def _joining(count: int, a: NDArray[np.int_], b: NDArray[np.int_]) -> NDArray[np.bool_]:
    """(L,) whether each of L pairs among `count` things joins what the pairs before it leave apart."""
    label, result = np.arange(count), np.zeros(len(a), dtype=bool)
    for k, (i, j) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        result[k] = label[i] != label[j]
        if result[k]:
            label[label == label[j]] = label[i]
    return result
