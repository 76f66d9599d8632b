"""What no effect explains, as real robots have it: smooth random errors, fixed to the configuration or to the time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden_effects.experiment import Experiment
from hidden_effects.rod import rotations
from hidden_effects.tube import Array

WAVES = 60
DEG_PER_MM = 1.5  # of the tangent, for each mm of the position
ROOM_M = 0.06  # of translation that counts as much as a radian


@dataclass(frozen=True)
class Leftover:
    """Rms `size_mm` of the position; `memory` in rad of joints where it is fixed to them, in s where to the time."""

    size_mm: float = 0.0
    kind: str = "configuration"  # or "time"
    memory: float = 1.0


def add_leftover(
    p: Array, tangent: Array, plan: Experiment, left: Leftover, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Positions and unit tangents (K, 3) with it."""
    if not left.size_mm:
        return p, tangent
    field = _field(_places(plan, left.kind), left.memory, rng)
    turn = np.deg2rad(DEG_PER_MM * left.size_mm) * field[:, 3:] / np.sqrt(2)
    turned = rotations(turn)[0] @ tangent[:, :, None]
    return p + 1e-3 * left.size_mm * field[:, :3] / np.sqrt(3), turned[:, :, 0]


def _places(plan: Experiment, kind: str) -> Array:
    """(K, d) where the poses are, in the units of the memory."""
    motion = plan.motion
    if kind == "time":
        return motion.time_s[plan.measured][:, None]
    turns = np.diff(motion.theta, axis=1)[plan.measured]
    return np.hstack([np.sin(turns), np.cos(turns), motion.l[plan.measured] / ROOM_M])


def _field(place: Array, memory: float, rng: np.random.Generator) -> Array:
    """(K, 6) a random smooth function with a standard deviation of 1 in every column."""
    waves = rng.standard_normal((WAVES, place.shape[1])) / memory
    phases = rng.uniform(-np.pi, np.pi, WAVES)
    amounts = rng.standard_normal((WAVES, 6)) * np.sqrt(2 / WAVES)
    return np.asarray(np.cos(place @ waves.T + phases) @ amounts)
