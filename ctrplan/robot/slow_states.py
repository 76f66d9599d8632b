"""What changes slowly beside the friction states: an offset of measured tips and parameters of the robot, by a
Kalman filter.

x = (offset of the tip, parameters less their values in the file), x' = F x + w, tip = p + (I, dp/dparameter) x.
Every friction state has an x of its own (Rao-Blackwell).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ctrplan.base.arguments import Number, checked
from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.tube import SOFTEST_NM2
from ctrplan.robot.named_numbers import HasNumbers, value_of, with_values


@checked(sigma_m=Number(0, 1, "m"), memory_steps=Number(1, math.inf))
@dataclass(frozen=True)
class SlowOffset:
    """A tip's offset in the tracker's frame: a normal error of each coordinate, correlated from step to step.

    Its correlation falls to 1/e in `memory_steps`. With inf it is a frame that stands somewhere else; with finite ones
    also what a model lacks, as far as that changes from step to step little.
    """

    sigma_m: float
    memory_steps: float = math.inf

    @property
    def kept(self) -> float:
        """What a step leaves of it."""
        return math.exp(-1.0 / self.memory_steps)


@checked(sigma=Number(0, 1e6, above=True), memory_steps=Number(1, math.inf))
@dataclass(frozen=True)
class SlowParameter:
    """A number that is off its value in the robot file by a normal error, and changes slowly if at all.

    Names as those of `Mechanics.tips_with_friction`: contact.1.friction_coefficient, tube.2.poisson_ratio, theta_b.2 or
    l_b.3 for the zero of a collar. SI. The correlation of its error falls to 1/e in `memory_steps`.
    """

    name: str
    sigma: float
    memory_steps: float = 200.0

    @property
    def is_of_collar(self) -> bool:
        """Whether it is the zero of a collar, which is no number of the mechanics."""
        return self.name.split(".")[0] in ("theta_b", "l_b")


LEAST = {"friction_coefficient": 0.0, "clearance_m": 1e-6, "length_m": 1e-3, "bending_stiffness_Nm2": SOFTEST_NM2}


class Followable(HasNumbers, Protocol):
    """A robot with its mechanics."""

    @property
    def n(self) -> int:
        """Number of tubes."""

    @property
    def mechanics(self) -> Mechanics:
        """The compiled model of the robot."""


def values_of_slow(robot: Followable, slow: Sequence[SlowParameter]) -> dict[SlowParameter, float]:
    """Each with its value, SI, zero for the zeros of collars. Raises InputError for names that the robot lacks."""
    given: object = slow
    for parameter in slow if isinstance(given, (list, tuple)) else [None]:
        if not isinstance(parameter, SlowParameter):
            raise InputError(
                "must be a list of SlowParameter", key="slow", value=given if parameter is None else parameter
            )
    names = [parameter.name for parameter in slow]
    for name in names:
        if names.count(name) > 1:
            raise InputError("is named twice", key=name)
    nowhere = np.zeros((0, robot.n))
    robot.mechanics.tips_with_friction(nowhere, nowhere, nowhere[:, 1:], parameters=names)  # refuses unknown names
    return {p: 0.0 if p.is_of_collar else value_of(robot, p.name) for p in slow}


def robot_with(robot: Followable) -> Callable[[Mapping[str, float]], Mechanics]:
    """The robot's mechanics with named numbers so much off its own."""

    def changed(off: Mapping[str, float]) -> Mechanics:
        values = {name: _possible(name, value_of(robot, name) + by) for name, by in off.items() if by}
        return with_values(robot, values).mechanics

    return lambda off: changed(off) if any(off.values()) else robot.mechanics


def _possible(name: str, value: float) -> float:
    least = next((least for key, least in LEAST.items() if name.endswith(key)), -np.inf)
    return max(value, least)


LEAST_SHARE = 0.02  # of the offset's stated variance that it can show
MOST_SIGMA = 4.0  # standard deviations that a slow parameter is simulated at
_UNITS = np.eye(3)


@dataclass(frozen=True, eq=False)
class Slow:
    """Mean (3 + P,) and covariance (3 + P, 3 + P) of the offset [m] and of P parameters."""

    mean: Array
    covariance: Array

    def moved_m(self, slopes: Array, values: Array) -> Array:
        """(3,) [m] what they displace a tip by; its slopes by the parameters (3, P), the values simulated with (P,)."""
        moved: Array = self.mean[:3] + slopes @ (self.mean[3:] - values)
        return moved

    def spread_m2(self, slopes: Array, share: float = 1.0) -> Array:
        """(3, 3) covariance of that; of the offset's variance a share."""
        return spread_m2(self.covariance, slopes, share)


def spread_m2(covariance: Array, slopes: Array, share: float = 1.0) -> Array:
    """(..., 3, 3) covariances of displaced tips, of covariances (..., 3 + P, 3 + P) and slopes (..., 3, P)."""
    own: Array = share * covariance[..., :3, :3]
    if not slopes.shape[-1]:
        return own
    across = np.swapaxes(slopes, -1, -2)
    between = math.sqrt(share) * covariance[..., :3, 3:] @ across
    return own + between + np.swapaxes(between, -1, -2) + slopes @ covariance[..., 3:, 3:] @ across


class SlowModel:
    """How offset and parameters change from step to step, and what a tip says about them."""

    def __init__(self, offset: SlowOffset, parameters: Sequence[SlowParameter]) -> None:
        """offset, parameters: as `Robot.observer` has them."""
        self.sigma = np.array([parameter.sigma for parameter in parameters])
        self.names = tuple(parameter.name for parameter in parameters)
        self.in_mechanics = np.array([not parameter.is_of_collar for parameter in parameters], dtype=bool)
        self._sigma = np.array([*[offset.sigma_m] * 3, *(parameter.sigma for parameter in parameters)])
        kept = [offset.kept] * 3 + [math.exp(-1.0 / parameter.memory_steps) for parameter in parameters]
        self._kept = np.array(kept)
        self._kept_twice = np.outer(self._kept, self._kept)
        self._grown = np.diag((1 - self._kept**2) * self._sigma**2)
        self._is_certain = not self._sigma.any()  # no offset and no parameters: there is nothing to filter
        self._off2 = self._expected2 = 0.0  # m^2, of a coordinate, means of the last steps

    def simulated(self, slow: Slow) -> Array:
        """(P,) what histories that begin now are simulated with; zeros of collars displace tips to first order only."""
        within: Array = np.clip(slow.mean[3:], -MOST_SIGMA * self.sigma, MOST_SIGMA * self.sigma) * self.in_mechanics
        return within

    def start(self) -> Slow:
        """Before anything is measured."""
        return Slow(np.zeros(len(self._kept)), np.diag(self._sigma**2))

    def after_step(self, slow: Slow) -> Slow:
        """A step later, without a measurement."""
        if self._is_certain:
            return slow
        return Slow(self._kept * slow.mean, self._kept_twice * slow.covariance + self._grown)

    def seen(self, slow: Sequence[Slow], slopes: Array, off_m: Array, noise_m2: float) -> Sequence[Slow]:
        """The estimates of H histories, after a tip was measured that is off_m (H, 3) [m] from where each expected it.

        slopes: (H, 3, P); noise [m^2] of a coordinate.
        """
        if self._is_certain:
            return slow
        mean, before = np.array([s.mean for s in slow]), np.array([s.covariance for s in slow])
        H = np.concatenate([np.broadcast_to(_UNITS, (len(slow), 3, 3)), slopes], axis=2)
        projected = H @ before
        gain = np.swapaxes(np.linalg.solve(projected @ np.swapaxes(H, 1, 2) + noise_m2 * _UNITS, projected), 1, 2)
        left = np.eye(H.shape[2]) - gain @ H
        covariance = left @ before @ np.swapaxes(left, 1, 2)  # stays symmetric and positive (Joseph)
        covariance += noise_m2 * gain @ np.swapaxes(gain, 1, 2)
        mean += (gain @ off_m[:, :, None])[:, :, 0]
        return [Slow(*of) for of in zip(mean, covariance, strict=True)]

    def learn(self, off_m: Array, expected_m2: float, news: float) -> None:
        """How much of its stated variance the offset shows: tips were off_m (3,) where expected_m2 was expected.

        news: what a step leaves of what is known. The filter goes by what is stated, intervals by what is shown.
        """
        if not self._expected2:
            self._off2 = self._expected2 = expected_m2
        self._off2 = news * self._off2 + (1 - news) * float(off_m @ off_m) / 3
        self._expected2 = news * self._expected2 + (1 - news) * expected_m2

    def shown_share(self, ahead: int) -> float:
        """The share of the offset's stated variance that is known so many steps ahead, the first from 0; far ahead,
        none.
        """
        share = min(1.0, max(self._off2 / self._expected2, LEAST_SHARE)) if self._expected2 else 1.0
        return float(share + (1 - share) * (1 - self._kept[0] ** (2 * ahead)))

    def slopes(self, mechanics: Mechanics, theta_b: Array, l_b: Array, phi: Array) -> Array:
        """(K, 3, P) derivatives of tips at collars (K, n) [rad], (K, n) [m] in friction states (K, n - 1)."""
        if not self.names:
            return np.zeros((len(theta_b), 3, 0))
        states = np.clip(phi, -1.0, 1.0)
        result = mechanics.tips_with_friction(theta_b, l_b, states, parameters=self.names, threads=1)
        return np.nan_to_num(result.position_by)
