"""Inverse kinematics of the zero-clearance model, many targets or starts at once: damped Newton steps, batched.

The Jacobian comes from one-sided differences of batched tips, is kept up with Broyden's rank-one formula and renewed
only where a step disappoints: some 16 tips a solve from a random start. A drive that can turn all tubes together turns
the tip about z exactly: one joint's column needs no difference, and starts are turned to the target's side first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, TINY, Array
from ctrplan.base.long_work import SearchWatch
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Status
from ctrplan.scenario.joint_space import JointSpace

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

STEP = 1e-5  # rad or m, of the differences
REACHED_M = 1e-5
ITERATIONS = 25
STALL_STEPS, MIN_PROGRESS = 6, 0.8  # steps after which the distance must have fallen to this share
PASSES = 3  # each holds the limits that the step before it broke
NO_STEP_M = 1e-7  # of weighted joint length, that changes nothing
LONGEST_STEP_M = 30e-3  # of weighted joint length
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-7, 1e4  # beside the squared singular values, m per m
M_PER_RAD = 20e-3  # weight of the tip's direction against its position
TOLERANCE_SHARE = 0.8  # of the direction's tolerance that is made use of

Rows = NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class TipTarget:
    """Where the tip shall be, robot's frame; `direction` (3,) unit vector or None."""

    tip_m: Array  # (3,), or (K, 3) one for each start
    direction: Array | None = None
    direction_tolerance_rad: float = np.inf


@dataclass(frozen=True, eq=False)
class TipSolutions:
    """Where K solves ended."""

    joints: Array  # (K, m)
    tip_m: Array  # (K, 3) zero-clearance
    tangent: Array  # (K, 3)
    error_m: Array  # (K,) distance of the tip from its target, inf where the model has no stable solution
    turned_rad: Array  # (K,) of the tangent from the target's direction, 0 without one

    def reached(self, target: TipTarget, within_m: float = REACHED_M) -> NDArray[np.bool_]:
        """(K,) bool: position within `within_m` and direction within its tolerance."""
        return np.asarray((self.error_m <= within_m) & (self.turned_rad <= target.direction_tolerance_rad))


@dataclass(frozen=True, eq=False)
class TipSolver:
    """Finds joint values (m,) whose zero-clearance tip is at a target; joints keep limits and nesting."""

    space: JointSpace
    mechanics: Mechanics
    watch: SearchWatch | None = None  # asked before every step

    def solve(
        self, target: TipTarget, starts: Array, iterations: int = ITERATIONS, *, turned: bool = True
    ) -> TipSolutions:
        """From starts (K, m), which must be allowed, each as near to its target as the steps lead.

        With `turned`, all tubes first turn together to the target's side.
        """
        work = _Batch(
            self, target, *self.turned_towards(target, starts) if turned else (starts.copy(), *self.tips(starts))
        )
        for _ in range(iterations):
            if self.watch:
                self.watch.ask()
            if not work.improve():
                break
        return work.solutions()

    def tips(self, q: Array) -> tuple[Array, Array]:
        """Zero-clearance tips and tangents (K, 3), (K, 3), loads left out; NaN tips without a stable solution."""
        tip, tangent, status = self.mechanics.tips(*self.space.drive.collars(q), loads=False)
        tip[status != Status.CONVERGED] = np.nan
        return tip, tangent

    @cached_property
    def common_rotation(self) -> Array | None:
        """(m,) joint velocities that turn all tubes together by 1 rad/s, the drive being ideal, or None if it can't."""
        drive = self.space.drive
        motions = np.vstack([drive.matrix_theta, drive.matrix_l])
        wanted = np.concatenate([np.ones(len(drive.matrix_theta)), np.zeros(len(drive.matrix_l))])
        turn: Array = np.linalg.lstsq(motions, wanted, rcond=None)[0]
        turn[np.abs(turn) < 1e-12] = 0.0
        return turn if np.allclose(motions @ turn, wanted, atol=1e-9) else None

    def jacobian(self, q: Array, tip: Array, tangent: Array) -> Array:
        """(K, 6, m) derivatives of tips and tangents at q (K, m), whose tips are known."""
        common = None if self.space.drive.terms else self.common_rotation  # with effects tubes turn unevenly
        spared = None if common is None else int(np.argmax(np.abs(common)))
        columns = [j for j in range(q.shape[1]) if j != spared]
        moved = np.repeat(q[None], len(columns), axis=0)
        for row, j in zip(moved, columns, strict=True):
            row[:, j] = self.beside(q, j)
        tips, tangents = self.tips(moved.reshape(-1, q.shape[1]))
        known, jacobian = np.hstack([tip, tangent]), np.zeros((len(q), 6, q.shape[1]))
        for row, j, near in zip(
            moved, columns, np.hstack([tips, tangents]).reshape(len(columns), len(q), 6), strict=True
        ):
            change = row[:, j] - q[:, j]
            change[change == 0] = np.inf  # a joint that can move to neither side contributes nothing
            jacobian[:, :, j] = (near - known) / change[:, None]
        if spared is not None and common is not None:
            rest = jacobian[:, :, columns] @ common[columns]
            jacobian[:, :, spared] = (_about_z(known) - rest) / common[spared]
        return np.nan_to_num(jacobian, nan=0.0, posinf=0.0, neginf=0.0)

    def beside(self, q: Array, j: int) -> Array:
        """(K,) joint j of q (K, m) a little further, on the side that is allowed."""
        result = q[:, j].copy()
        todo = np.ones(len(q), dtype=bool)
        for step in (STEP, -STEP):
            moved = q.copy()
            moved[:, j] += step
            fits = todo & self.space.allowed_rows(moved)
            result[fits] = moved[fits, j]
            todo &= ~fits
            if not todo.any():
                break
        return result

    def turned_towards(self, target: TipTarget, q: Array) -> tuple[Array, Array, Array]:
        """Starts with all tubes turned together so that the tip's azimuth is the target's, where limits allow.

        And their tips and tangents (K, 3), (K, 3), which turn with them, if the drive is ideal.
        """
        tip, tangent = self.tips(q)
        if self.common_rotation is None or len(q) == 0:
            return q.copy(), tip, tangent
        goal = np.broadcast_to(target.tip_m, tip.shape)
        angle = np.nan_to_num(np.arctan2(goal[:, 1], goal[:, 0]) - np.arctan2(tip[:, 1], tip[:, 0]))
        turned = self.space.wound_into_limits(q + angle[:, None] * self.common_rotation)
        allowed = self.space.allowed_rows(turned)
        result = np.where(allowed[:, None], turned, q)
        if self.space.drive.terms:
            return result, *self.tips(result)
        angle = np.where(allowed, angle, 0.0)
        return result, _turned(tip, angle), _turned(tangent, angle)


class _Batch:
    """The state of K solves."""

    def __init__(self, solver: TipSolver, target: TipTarget, q: Array, tip: Array, tangent: Array) -> None:
        """q (K, m) with its tips and tangents (K, 3), (K, 3)."""
        self.solver, self.target, self.q, self.tip, self.tangent = solver, target, q, tip, tangent
        self.goal = np.broadcast_to(target.tip_m, self.tip.shape)
        self.miss = self._miss(np.arange(len(q)), self.tip, self.tangent)
        self.error = _length(self.miss)
        self.jacobian = solver.jacobian(q, self.tip, self.tangent)
        self.damping = np.full(len(q), DAMPING)
        self.fresh = np.ones(len(q), dtype=bool)
        self.steps, self.earlier = 0, self.error.copy()

    def improve(self) -> bool:
        """One step of every solve that is not done; False when all are."""
        rows = np.flatnonzero((self.error > REACHED_M) & (self.damping < MOST_DAMPING) & np.isfinite(self.error))
        if not len(rows):
            return False
        self._give_up(rows)
        space, q = self.solver.space, self.q[rows]
        moved = self._moved(rows)
        tip, tangent = self.solver.tips(moved)
        miss = self._miss(rows, tip, tangent)
        error = _length(miss)
        better = error < 0.999 * self.error[rows]
        self._learn(rows, (moved - q) * space.weights_mm / MM_PER_M, self.miss[rows] - miss)
        disappointing = ~(error < 0.5 * self.error[rows])
        self.damping[rows] = np.where(
            better, np.maximum(0.1 * self.damping[rows], LEAST_DAMPING), 10 * self.damping[rows]
        )
        kept = rows[better]
        self.q[kept], self.tip[kept], self.tangent[kept] = moved[better], tip[better], tangent[better]
        self.miss[kept], self.error[kept] = miss[better], error[better]
        self._renew(rows[disappointing & ~self.fresh[rows]], rows)
        return True

    def _give_up(self, rows: Rows) -> None:
        """Ends solves that make no headway, before the step after this one."""
        self.steps += 1
        if self.steps % STALL_STEPS == 0:
            stuck = self.error[rows] > MIN_PROGRESS * self.earlier[rows]
            self.damping[rows[stuck]] = MOST_DAMPING
            self.earlier[rows] = self.error[rows]

    def solutions(self) -> TipSolutions:
        """Where the solves are."""
        error = _length(self.goal - self.tip)
        return TipSolutions(self.q, self.tip, self.tangent, error, angle_to(self.tangent, self.target.direction))

    def _moved(self, rows: Rows) -> Array:
        """(K, m) a damped step further; along the limits and nesting that it runs into."""
        space, q = self.solver.space, self.q[rows]
        weights, count = space.weights_mm / MM_PER_M, 3 if self.target.direction is None else 6
        slope = self._weighted(rows)[:, :count] / weights
        for _ in range(PASSES):
            moved = q + damped_steps(slope, self.miss[rows, :count], self.damping[rows]) / weights
            self._hold(slope, moved)
        return space.projected(moved, fallback=q)

    def _hold(self, slope: Array, moved: Array) -> None:
        """Takes out of `slope` (K, 3 or 6, m) the motions that carried `moved` beyond a limit or out of nesting."""
        space = self.solver.space
        rules, room = space.nesting_rules
        for row, limit in zip(rules, room, strict=True):
            broken = moved @ row > limit
            along = row / np.linalg.norm(row)  # all translations weigh the same
            slope[broken] -= (slope[broken] @ along)[:, :, None] * along
        outside = (moved < space.drive.lower) | (moved > space.drive.upper)
        slope *= ~outside[:, None, :]

    def _weighted(self, rows: Rows) -> Array:
        """(K, 6, m) derivatives of what `_miss` measures."""
        slope: Array = self.jacobian[rows]
        slope[:, 3:] *= direction_weight(self.target, self.tangent[rows])[:, None, None]
        return slope

    def _miss(self, rows: Rows, tip: Array, tangent: Array) -> Array:
        """(K, 6) [m] of position, and of direction beyond its tolerance."""
        return miss_of(self.target, np.hstack([tip, tangent]), self.goal[rows])[0]

    def _learn(self, rows: Rows, step_m: Array, change: Array) -> None:
        """Broyden: the derivatives that are nearest to the old ones and explain the last step, position only."""
        weights = self.solver.space.weights_mm / MM_PER_M
        slope = self.jacobian[rows, :3] / weights
        unexplained = change[:, :3] - np.einsum("kij,kj->ki", slope, step_m)
        unexplained[~np.isfinite(unexplained)] = 0.0
        size = np.maximum(np.sum(step_m**2, axis=1), 1e-18)
        slope += (unexplained / size[:, None])[:, :, None] * step_m[:, None, :]
        self.jacobian[rows, :3] = slope * weights

    def _renew(self, rows: Rows, tried: Rows) -> None:
        self.fresh[tried] = False
        rows = rows[self.error[rows] > REACHED_M]
        if len(rows):
            self.jacobian[rows] = self.solver.jacobian(self.q[rows], self.tip[rows], self.tangent[rows])
            self.fresh[rows] = True


def direction_weight(target: TipTarget, tangent: Array) -> Array:
    """(K,) [m per rad] what the directions of tips with tangents (K, 3) weigh; nothing within the tolerance."""
    if target.direction is None:
        return np.zeros(len(tangent))
    turned = np.maximum(angle_to(tangent, target.direction), 1e-12)
    return np.asarray(M_PER_RAD * np.maximum(0.0, 1 - TOLERANCE_SHARE * target.direction_tolerance_rad / turned))


def miss_of(target: TipTarget, pose: Array, goal_m: Array | None = None) -> tuple[Array, Array]:
    """(K, 6) [m] of tips and of their directions beyond the tolerance, and what a direction weighs (K,) [m per rad].

    goal_m: (K, 3) where each tip shall be, if that is not the same for all.
    """
    miss, weight = np.zeros_like(pose), direction_weight(target, pose[:, 3:])
    miss[:, :3] = (target.tip_m if goal_m is None else goal_m) - pose[:, :3]
    if target.direction is not None:
        miss[:, 3:] = weight[:, None] * (target.direction - pose[:, 3:])
    return miss, weight


def damped_steps(slope: Array, miss: Array, damping: Array | float = DAMPING) -> Array:
    """(K, m) least-squares steps that take off what misses (K, r), by derivatives (K, r, m) in m per m.

    None is longer than LONGEST_STEP_M. damping: beside the squared singular values, one or (K,).
    """
    gram = slope @ np.swapaxes(slope, 1, 2) + np.multiply.outer(damping, np.eye(slope.shape[1]))
    step = np.einsum("kij,ki->kj", slope, np.linalg.solve(gram, miss[:, :, None])[:, :, 0])
    return np.asarray(step * np.minimum(1.0, LONGEST_STEP_M / np.maximum(_length(step), 1e-12))[:, None])


@dataclass(eq=False)
class MotionLines:
    """What joint motions from a place do, on straight lines; joints weighted to m. Broyden's formula corrects them."""

    joints: Array  # (m,) of the place, rad or m
    weights: Array  # (m,)
    slope: Array  # (6, m) of the pose
    rows: Array  # (R, m) of what is limited: joints, speeds, nesting
    room: Array  # (R,)
    closer: Array  # (C, m), spare (C,), near (C,): `closer_by_joints`
    spare: Array
    near: NDArray[np.intp]
    refused: bool = False  # a way from there

    def motion(self, target: TipTarget, joints: Array, pose: Array) -> Array:
        """(m,) rad or m, to bring the pose (1, 6), known at joints (m,), to the target as far as limits allow."""
        miss, weight = miss_of(target, pose)
        slope = self.slope.copy()
        slope[3:] *= weight[0]
        aim = miss[0] + slope @ self._weighted(joints)
        rows, room = np.vstack([self.rows, self.closer]), np.append(self.room, np.maximum(self.spare, 0.0))
        return least_squares_within(slope, aim, rows, room) / self.weights

    def gain(self, target: TipTarget, joints: Array, pose: Array, then: Array) -> float:
        """The share of a miss that moving on to joints `then` (m,) is expected to take off; arguments of `motion`."""
        change = self.slope @ ((then - joints) * self.weights)
        left, expected = (float(np.linalg.norm(miss_of(target, at)[0])) for at in (pose, pose + change))
        return 1 - expected / max(left, NO_STEP_M)

    def learn_tip(self, moved: Array, change: Array) -> float:
        """Takes in how a motion (m,) changed the pose (1, 6); how far [m] the tip is from where it was expected."""
        moved = moved * self.weights
        off = change[0] - self.slope @ moved
        self.slope = self.slope + np.outer(off, moved) / max(float(moved @ moved), NO_STEP_M**2)
        return float(np.linalg.norm(off[:3]))

    def learn_body(self, joints: Array, rooms: Array) -> None:
        """Takes in rooms on all stretches at other joints."""
        moved, self.refused = self._weighted(joints), True
        off = self.spare - rooms[self.near] - self.closer @ moved
        self.closer = self.closer + np.outer(off, moved) / max(float(moved @ moved), NO_STEP_M**2)

    def _weighted(self, joints: Array) -> Array:
        return np.asarray((joints - self.joints) * self.weights)


def least_squares_within(slope: Array, aim: Array, rows: Array, room: Array) -> Array:
    """The x (m,) with least |slope x - aim|^2 + DAMPING |x|^2 where rows (R, m) x <= room (R,), none negative."""
    x = least_within(slope.T @ slope + DAMPING * np.eye(slope.shape[1]), -slope.T @ aim, rows, room)
    assert x is not None, "nothing moves, and all is within room"
    return x


def least_within(curvature: Array, slope: Array, rows: Array, room: Array) -> Array | None:
    """The x (X,) with least x curvature x / 2 + slope x where rows (R, X) x <= room (R,); None where there is none.

    Lawson and Hanson's way: as the least distance from the free solution, by non-negative least squares.
    """
    from scipy.linalg import solve_triangular  # slow to import, and of no use to whoever only reaches a point
    from scipy.optimize import nnls

    upper = np.linalg.cholesky(curvature).T
    free = solve_triangular(upper, solve_triangular(upper, -slope, trans="T"))
    over = rows @ free - room
    if np.all(over <= 0):
        return np.asarray(free)
    scale = float(np.abs(over).max())
    turned = -solve_triangular(upper, rows.T, trans="T")
    weights, _ = nnls(np.vstack([turned, over / scale]), np.append(np.zeros(len(free)), 1.0))
    rest = 1 - over @ weights / scale  # nothing where no x is within room
    return None if rest < TINY else np.asarray(free + scale / rest * solve_triangular(upper, turned @ weights))


def angle_to(tangent: Array, direction: Array | None) -> Array:
    """(K,) angles [rad] between tangents (K, 3) and a direction (3,); 0 without one."""
    if direction is None:
        return np.zeros(len(tangent))
    across = np.asarray(np.cross(tangent, direction), dtype=np.float64)
    return np.asarray(np.arctan2(_length(across), tangent @ direction))


def _turned(vectors: Array, angle: Array) -> Array:
    """Vectors (K, 3) turned about z by angles (K,) [rad]."""
    (x, y, z), c, s = vectors.T, np.cos(angle), np.sin(angle)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def _about_z(vectors: Array) -> Array:
    """(K, 6) velocities of tips and tangents while everything turns about z by 1 rad/s."""
    x, y, _, tx, ty, _ = vectors.T
    return np.stack([-y, x, 0 * x, -ty, tx, 0 * x], axis=1)


def _length(vectors: Array) -> Array:
    length: Array = np.linalg.norm(vectors, axis=1)
    return np.where(np.isnan(length), np.inf, length)


@dataclass(frozen=True, eq=False)
class GoalState:
    """A configuration at the goal and what it is worth."""

    joints: Array  # (m,)
    bound_m: float  # worst-case friction error of the tip
    tip_error_m: float  # frictionless tip to the target


def tip_target(scenario: Scenario) -> TipTarget:
    """The goal's tip and direction in the robot's frame."""
    goal = scenario.goal
    direction = None if goal.direction is None else scenario.base_R.T @ goal.direction
    tolerance = np.inf if goal.direction_tolerance_rad is None else goal.direction_tolerance_rad
    return TipTarget(target_in_robot_frame(scenario), direction, tolerance)


def target_in_robot_frame(scenario: Scenario) -> Array:
    """(3,) the goal's tip position [m] in the robot's frame."""
    assert scenario.goal.tip_m is not None
    target: Array = scenario.base_R.T @ (scenario.goal.tip_m - scenario.base_position_m)
    return target
