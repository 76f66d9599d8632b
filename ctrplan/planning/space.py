"""Joint space of a drive: differences, lengths, L-shaped motions. Nothing of OMPL here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.drive import Array, Drive
from ctrplan.nesting import TOLERANCE_M, nesting_inequalities
from ctrplan.planning.plan import MotionStyle

if TYPE_CHECKING:
    from ctrplan.scenario import Scenario

MM_PER_M = 1e3


@dataclass(frozen=True, eq=False)
class JointSpace:
    """Actuated joints (m,) in rad and m, weighted to mm."""

    drive: Drive
    weights_mm: Array  # (m,) mm of joint length per rad or m
    nesting_G: Array  # (r, n)
    nesting_h: Array  # (r,) base translations nest where nesting_G @ l_b <= nesting_h

    @classmethod
    def of(cls, scenario: Scenario) -> JointSpace:
        """The joint space of a scenario's robot, weighted as its cost says."""
        drive = scenario.robot.drive
        G, h = nesting_inequalities(scenario.robot.tubes)
        return cls(drive, np.where(drive.is_rotation, scenario.cost.mm_per_rad, MM_PER_M), G, h)

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

    def corners(self, a: Array, b: Array, style: MotionStyle) -> Array:
        """(K, m) start, corner if both kinds of joints move, end; windings continue from a."""
        delta = self.difference(a, b)
        rotation = np.where(self.drive.is_rotation, delta, 0)
        if style == "simultaneous" or not rotation.any() or np.array_equal(rotation, delta):
            return np.array([a, a + delta])
        return np.array([a, a + rotation, a + delta])

    def allowed(self, q: ArrayLike) -> bool:
        """Whether limits and nesting hold at q (m,) or at every row of q (K, m)."""
        return bool(np.all(self.allowed_rows(np.atleast_2d(q))))

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

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """(count, m) joint vectors within limits, uniform, nested; unlimited rotations in (-pi, pi]."""
        low = np.where(self.drive.wraps, -math.pi, self.drive.lower)
        high = np.where(self.drive.wraps, math.pi, self.drive.upper)
        found: list[Array] = []
        for _ in range(20):
            q = rng.uniform(low, high, (count, low.size))
            _, l_b = self.drive.collars(q)
            found.extend(q[np.all(l_b @ self.nesting_G.T <= self.nesting_h + TOLERANCE_M, axis=1)])
            if len(found) >= count:
                break
        return np.array(found[:count]).reshape(-1, low.size)


def l_shaped(path: ArrayLike, scenario: Scenario) -> Array:
    """(L, m) corners of the L-shaped motions through the states of path (K, m), rotations before translations.

    For planners whose edges are priced by `BoundObjective`: unlimited rotations take the shorter way, as the objective
    assumes; hand the result to `ctrplan.reorder`.
    """
    states = np.array(path, dtype=np.float64)
    space = JointSpace.of(scenario)
    corners = [states[0]]
    for target in states[1:]:
        corners.extend(space.corners(corners[-1], target, "rotations before translations")[1:])
    return np.array(corners)
