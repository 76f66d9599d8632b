"""Terms of the drive, commanded joints -> collars, and of the clock."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hidden_effects.tube import Array
from hidden_effects.world import Motion

CALMING_SWINGS = 5  # that many, each smaller than the one before, are an oscillation of decreasing amplitude


@dataclass(frozen=True)
class Offset:
    """Zero offsets theta, l (n,)."""

    theta: Array
    l: Array  # noqa: E741

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta + self.theta, l=motion.l + self.l)


@dataclass(frozen=True)
class Scale:
    """Joints times 1 + excess (n,) for rotations and translations."""

    theta: Array
    l: Array  # noqa: E741

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta * (1 + self.theta), l=motion.l * (1 + self.l))


@dataclass(frozen=True)
class Backlash:
    """Half of the backlash (n,) [rad] against the last direction of each rotation."""

    theta: Array

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta - self.theta / 2 * last_direction(motion))


@dataclass(frozen=True)
class Eccentricity:
    """theta + amplitude sin(harmonic theta + phase), (n,) each."""

    amplitude: Array
    phase: Array
    harmonic: int = 1

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta + self.amplitude * np.sin(self.harmonic * motion.theta + self.phase))


@dataclass(frozen=True)
class CrossTalk:
    """Rotations that turn others along: theta + share (n, n) theta."""

    share: Array

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta + motion.theta @ np.asarray(self.share).T)


@dataclass(frozen=True)
class Screw:
    """Translations turn the tubes: theta + rate (n,) [rad/m] (l - reference)."""

    rate: Array
    reference: Array

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta + self.rate * (motion.l - self.reference))


@dataclass(frozen=True)
class Slip:
    """From a time on the tubes are turned by theta (n,) in their collars."""

    theta: Array
    time_s: float

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta + np.outer(motion.time_s >= self.time_s, self.theta))


@dataclass(frozen=True)
class PlateFriction:
    """Rotation lost behind the plate, against the last direction and in proportion to the length there: rad/m (n,)."""

    loss: Array

    def __call__(self, motion: Motion) -> Motion:
        return replace(motion, theta=motion.theta - self.loss * np.abs(motion.l) * last_direction(motion))


def last_direction(motion: Motion) -> Array:
    """Sign of the last move of every rotation within its sequence, (K, n).

    0 before the first move, and after an oscillation of decreasing amplitude, which leaves the play in its middle.
    """
    theta = motion.theta
    fresh = np.r_[True, np.diff(motion.sequence) != 0]
    move = np.where(fresh[:, None], 0.0, np.round(np.diff(theta, axis=0, prepend=theta[:1]), 9))
    sign, swings = np.sign(move), np.zeros(theta.shape, dtype=int)
    for k in range(1, len(sign)):
        if fresh[k]:
            continue
        calming = (move[k] * move[k - 1] < 0) & (np.abs(move[k]) < np.abs(move[k - 1]))
        swings[k] = np.where(calming, swings[k - 1] + 1, 0)
        sign[k] = np.where(swings[k] >= CALMING_SWINGS, 0.0, np.where(sign[k] == 0, sign[k - 1], sign[k]))
    return np.asarray(sign)
