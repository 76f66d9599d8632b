"""Joint space of a drive: differences, lengths, L-shaped motions. Nothing of OMPL here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import Made, checked
from ctrplan.base.arrays import MM_PER_M, Array, numbers, read_only
from ctrplan.drive.drive import Drive
from ctrplan.errors import InputError
from ctrplan.mechanics.tube import TOLERANCE_M, reach_inequalities

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

MotionStyle = Literal["rotations before translations", "simultaneous"]

PROJECTIONS = 12  # rounds over limits and nesting, which are few and nearly orthogonal
MM_PER_RAD = 20.0  # where no scenario says otherwise


@dataclass(frozen=True, eq=False)
class JointSpace:
    """Actuated joints (m,) in rad and m, weighted to mm."""

    drive: Drive
    weights_mm: Array  # (m,) mm of joint length per rad or m
    nesting_G: Array  # (r, n)
    nesting_h: Array  # (r,) base translations are allowed where nesting_G @ l_b <= nesting_h

    @classmethod
    def of(cls, scenario: Scenario) -> JointSpace:
        """The joint space of a scenario's robot, weighted as its cost says."""
        return cls.of_robot(scenario.robot, scenario.cost.mm_per_rad)

    @classmethod
    def of_robot(cls, robot: Robot, mm_per_rad: float = MM_PER_RAD) -> JointSpace:
        """The joint space of a robot, 1 rad counted as `mm_per_rad`."""
        G, h = reach_inequalities(robot.tubes)
        return cls(robot.drive, np.where(robot.drive.is_rotation, mm_per_rad, MM_PER_M), G, h)

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

    def allowed(self, q: ArrayLike) -> bool:
        """Whether limits and nesting hold at q (m,) or at every row of q (K, m)."""
        return bool(np.all(self.allowed_rows(np.atleast_2d(numbers(q, "joint values")))))

    def allowed_rows(self, q: Array) -> NDArray[np.bool_]:
        """(K,) whether limits and nesting hold at each row of q (K, m)."""
        within = np.all((q >= self.drive.lower - 1e-9) & (q <= self.drive.upper + 1e-9), axis=1)
        _, l_b = self.drive.collars(q)
        rows: NDArray[np.bool_] = within & np.all(l_b @ self.nesting_G.T <= self.nesting_h + TOLERANCE_M, axis=1)
        return rows

    def violation(self, q: Array) -> str:
        """Sentence about the first row of q (K, m) that breaks a limit or the nesting."""
        row = int(np.argmin(self.allowed_rows(q)))
        outside = (q[row] < self.drive.lower - 1e-9) | (q[row] > self.drive.upper + 1e-9)
        if not outside.any():
            return f"row {row}: the tubes' bases or tips are not nested"
        joint = self.drive.joints[int(np.argmax(outside))]
        value, low, high = (x / joint.si_per_unit for x in (q[row][outside][0], joint.lower, joint.upper))
        return f"row {row}: {joint.name} = {value:g} {joint.unit}: must be within {low:g} and {high:g} {joint.unit}"

    def projected(self, q: Array, fallback: Array) -> Array:
        """q (K, m) moved into limits and nesting, by turns; rows of `fallback` where that did not succeed."""
        (slope, room), moves = self.nesting_rules, q.copy()
        norms = np.sum(slope**2, axis=1)
        for _ in range(PROJECTIONS):
            moves = np.clip(moves, self.drive.lower, self.drive.upper)
            if np.all(moves @ slope.T <= room + TOLERANCE_M):
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
            results.extend(q[np.all(l_b @ self.nesting_G.T <= self.nesting_h + TOLERANCE_M, axis=1)])
            if len(results) >= count:
                break
        return np.array(results[:count]).reshape(-1, low.size)

    def _ranges(self) -> tuple[Array, Array]:
        """Limits (m,), (m,), of unlimited rotations -pi and pi."""
        unlimited = self.drive.is_unlimited
        return np.where(unlimited, -math.pi, self.drive.lower), np.where(unlimited, math.pi, self.drive.upper)


@checked(scenario=Made("Scenario"))
def l_shaped(path: ArrayLike, scenario: Scenario) -> Array:
    """(L, m) corners of the L-shaped motions through the states of path (K, m), rotations before translations.

    For planners whose edges are priced by `BoundObjective`: unlimited rotations take the shorter way, as the objective
    assumes; hand the result to `ctrplan.reorder`. Raises InputError for a path of another shape.
    """
    states, m = numbers(path, "path").copy(), len(scenario.robot.drive.joints)
    if states.ndim != 2 or states.shape[1] != m or not len(states) or not np.all(np.isfinite(states)):
        raise InputError(f"must be finite, of shape (K, {m}) with K >= 1, not {states.shape}", key="path")
    space = JointSpace.of(scenario)
    corners = [states[0]]
    for target in states[1:]:
        corners.extend(space.corners(corners[-1], target, "rotations before translations")[1:])
    return np.array(corners)
