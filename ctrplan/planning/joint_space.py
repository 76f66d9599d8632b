"""Joint space of a drive: differences, lengths, L-shaped motions. Nothing of OMPL here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

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

    def straight_length_mm(self, delta: Array) -> float:
        """Weighted length of a straight motion: Euclidean over the joints that move together."""
        return float(np.linalg.norm(delta * self.weights_mm))

    def length_mm(self, delta: Array, style: MotionStyle) -> float:
        """Weighted joint length of a motion: its rotations, then its translations, or both at once."""
        if style == "simultaneous":
            return self.straight_length_mm(delta)
        rotation = self.drive.is_rotation
        return self.straight_length_mm(np.where(rotation, delta, 0)) + self.straight_length_mm(
            np.where(rotation, 0, delta)
        )

    def corners(self, a: Array, b: Array, style: MotionStyle) -> Array:
        """(K, m) start, corner if both kinds of joints move, end; windings continue from a."""
        delta = self.difference(a, b)
        rotation = np.where(self.drive.is_rotation, delta, 0)
        if style == "simultaneous" or not rotation.any() or np.array_equal(rotation, delta):
            return np.array([a, a + delta])
        return np.array([a, a + rotation, a + delta])

    def allowed(self, q: ArrayLike) -> bool:
        """Whether limits and nesting hold at q (m,) or at every row of q (K, m)."""
        values = np.atleast_2d(q)
        if np.any(values < self.drive.lower - 1e-9) or np.any(values > self.drive.upper + 1e-9):
            return False
        _, l_b = self.drive.collars(values)
        return bool(np.all(l_b @ self.nesting_G.T <= self.nesting_h + TOLERANCE_M))

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
