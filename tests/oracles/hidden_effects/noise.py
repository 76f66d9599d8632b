"""Noise of the tracker: Gaussian, heavy-tailed, or of another size than the robot file states."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hidden_effects.rod import rotations
from hidden_effects.tube import Array

POSITION_SIGMA_M = 0.4e-3
TANGENT_SIGMA_RAD = np.deg2rad(0.5)

Sampler = Callable[[np.random.Generator, int], Array]  # (K, 6) of unit stated standard deviation


def gaussian(rng: np.random.Generator, count: int) -> Array:
    return rng.standard_normal((count, 6))


def heavy(rng: np.random.Generator, count: int) -> Array:
    """Student's t with 3 degrees of freedom, one scale for all six numbers of a pose; standard deviation 1."""
    scale = np.sqrt(1.0 / rng.chisquare(3, count))  # t = normal sqrt(3 / chi2), whose standard deviation is sqrt(3)
    return np.asarray(rng.standard_normal((count, 6)) * scale[:, None])


def understated(rng: np.random.Generator, count: int) -> Array:
    """The file states two thirds of the true noise."""
    return 1.5 * rng.standard_normal((count, 6))


def overstated(rng: np.random.Generator, count: int) -> Array:
    """The file states 1.5 times the true noise."""
    return rng.standard_normal((count, 6)) / 1.5


NOISE: dict[str, Sampler] = {f.__name__: f for f in (gaussian, heavy, understated, overstated)}


def add_noise(p: Array, tangent: Array, kind: str, rng: np.random.Generator) -> tuple[Array, Array]:
    """Measured positions and unit tangents (K, 3)."""
    units = NOISE[kind](rng, len(p))
    turned = rotations(TANGENT_SIGMA_RAD * units[:, 3:])[0] @ tangent[:, :, None]
    return p + POSITION_SIGMA_M * units[:, :3], turned[:, :, 0]
