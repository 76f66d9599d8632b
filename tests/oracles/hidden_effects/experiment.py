"""What a laboratory does: configurations and the ways to approach them, or one continuous motion logged at 10 Hz."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from hidden_effects.mesh import Fineness, stations
from hidden_effects.rod import Rod
from hidden_effects.start import common_centreline, stability
from hidden_effects.tube import Array
from hidden_effects.world import Motion, World

QUARTER = np.pi / 2
OSCILLATION = np.deg2rad([*[(-1) ** k * (40 - 2 * k) for k in range(20)], 0])
TURN_S, SWING_S, PAUSE_S = 2.0, 1.0, 1.0
LEAST_STABILITY = 1.2  # of the torsion, times L^2 / GJ of the innermost tube; a tube by itself has 2.47
LOG_S = 0.1


@dataclass(frozen=True)
class Experiment:
    """Commanded joint rows; which of them are measured, and how friction was left there."""

    motion: Motion
    measured: Array  # (K,) bool
    phi: Array  # (K, n - 1) loaded by the last rotation, before any translation
    translated_m: Array  # (K, n - 1) relative translation after that
    continuous: bool = False

    @property
    def duration_s(self) -> float:
        return float(self.motion.time_s[-1])


def draw_configurations(
    world: World, count: int, rng: np.random.Generator, least_stability: float = LEAST_STABILITY
) -> tuple[Array, Array]:
    """Rotations and translations (count, n) of stable configurations of the believed robot."""
    thetas: list[Array] = []
    ls: list[Array] = []
    while len(thetas) < count:
        theta = np.concatenate([[0.0], np.cumsum(rng.uniform(-np.pi, np.pi, world.n - 1))])
        l_b = np.cumsum([low if low == high else rng.uniform(low, high) for low, high in world.travel_m])
        if is_calm(world, theta, l_b, least_stability):
            thetas.append(theta)
            ls.append(l_b)
    return np.array(thetas), np.array(ls)


def is_calm(world: World, theta: Array, l_b: Array, least_stability: float = LEAST_STABILITY) -> bool:
    """Far from snapping, and the same shape from wherever it is approached."""
    s = stations(world.tubes, l_b, Fineness(3e-3, 8e-3, 1.5, 1))
    rods = [Rod(tube, base, s, 1) for tube, base in zip(world.tubes, l_b.tolist(), strict=True)]
    _, angles = common_centreline(rods, theta, len(s) - 1)
    if stability(rods, angles, len(s) - 1) < least_stability:
        return False
    for turn in product((-1.2, 0.0, 1.2), repeat=world.n - 1):
        _, others = common_centreline(rods, theta, len(s) - 1, np.array([0.0, *turn]))
        if abs(others[-1][-1] - angles[-1][-1]) > 1e-3:
            return False
    return True


def approaches(
    world: World,
    count: int,
    rng: np.random.Generator,
    *,
    translate_last: bool = False,
    least_stability: float = LEAST_STABILITY,
) -> Experiment:
    """Every configuration by quarter turns of the pairs in all directions and by a decreasing oscillation.

    With `translate_last` half of the configurations are rotated into 1 to 3 mm off and reached by a translation.
    """
    rows: list[tuple[Array, Array, float, int, bool, Array, Array]] = []
    clock, sequence, n = 0.0, 0, world.n
    none, swung = np.zeros(n - 1), np.arange(n) if n < 4 else np.arange(n) % 2  # no tube by more than half a turn
    thetas, ls = draw_configurations(world, count, rng, least_stability)
    for k, (theta, l_b) in enumerate(zip(thetas, ls, strict=True)):
        away = np.zeros(n)
        if translate_last and k % 2:
            away[-1] = rng.uniform(1e-3, 3e-3) * rng.choice([-1, 1])
        for signs in product((1.0, -1.0), repeat=n - 1):
            phi = np.array(signs)
            back = np.concatenate([[0.0], np.cumsum(phi * QUARTER)])
            rows.append((theta - back, l_b + away, clock, sequence, False, none, none))
            if np.abs(back).max() > np.pi:  # a reader of rows could not tell which way round it went
                halfway = (theta - back / 2, l_b + away, clock + TURN_S / 2, sequence, False, none, none)
                rows.append(halfway)
            if away.any():
                rows.append((theta, l_b + away, clock + TURN_S, sequence, False, phi, none))
                clock += 1.0
            rows.append((theta, l_b, clock + TURN_S, sequence, True, phi, np.abs(np.diff(away))))
            clock += TURN_S + PAUSE_S
            sequence += 1
        for swing in OSCILLATION:
            rows.append((theta + swing * swung, l_b, clock, sequence, swing == 0, none, none))
            clock += SWING_S
        clock += PAUSE_S - SWING_S
        sequence += 1
    theta_rows, l_rows, times, sequences, measured, phis, moves = zip(*rows, strict=True)
    motion = Motion(np.array(theta_rows), np.array(l_rows), np.array(times), np.array(sequences))
    return Experiment(motion, np.array(measured), np.array(phis), np.array(moves))


def continuous_motion(world: World, count: int, rng: np.random.Generator) -> Experiment:
    """One smooth motion of the inner tubes through calm configurations, `count` rows at 10 Hz."""
    time_s = LOG_S * np.arange(count)
    while True:
        theta = np.zeros((count, world.n))
        l_b = np.tile(world.middle_m, (count, 1))
        for i in range(1, world.n):
            theta[:, i] = theta[:, i - 1] + rng.uniform(-np.pi, np.pi) + _wave(time_s, 1.1, rng)
        l_b[:, -1] += _wave(time_s, 0.012, rng)
        if all(is_calm(world, theta[k], l_b[k]) for k in range(0, count, 8)):
            break
    motion = Motion(theta, l_b, time_s, np.zeros(count, dtype=int))
    nothing = np.zeros((count, world.n - 1))
    return Experiment(motion, np.ones(count, dtype=bool), nothing, nothing, continuous=True)


def _wave(time_s: Array, amplitude: float, rng: np.random.Generator) -> Array:
    periods, phases = rng.uniform(6.0, 16.0, 2), rng.uniform(-np.pi, np.pi, 2)
    return np.asarray(
        sum(amplitude / 2 * np.sin(2 * np.pi * time_s / T + a) for T, a in zip(periods, phases, strict=True))
    )
