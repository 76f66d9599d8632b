"""Terms of the sensor: tips (K, 3), tip frames (K, 3, 3), time_s (K,) -> what it reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden_effects.rod import rotations
from hidden_effects.tube import Array
from hidden_effects.world import Room


@dataclass(frozen=True)
class Misalignment:
    """The tracker's frame turned by a rotation vector (3,) [rad] and shifted (3,) [m] against the robot's."""

    rotation: Array
    translation_m: Array

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        R = rotations(np.asarray(self.rotation)[None])[0][0]
        return p @ R.T + self.translation_m, R @ F


@dataclass(frozen=True)
class TipOffset:
    """The sensor sits at an offset (3,) [m] in the tip's frame."""

    offset_m: Array

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        return p + F @ self.offset_m, F


@dataclass(frozen=True)
class Distortion:
    """Field of the tracker: sum of amplitude (W, 3) [m] times sin(wave (W, 3) [rad/m] p + phase (W,))."""

    amplitude_m: Array
    wave_per_m: Array
    phase: Array

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        angle = p @ self.wave_per_m.T + self.phase
        slope = np.einsum("kw,wi,wj->kij", np.cos(angle), self.amplitude_m, self.wave_per_m)
        turned = F + slope @ F
        turned[:, :, 2] /= np.linalg.norm(turned[:, :, 2], axis=1)[:, None]
        return p + np.sin(angle) @ self.amplitude_m, turned


@dataclass(frozen=True)
class Drift:
    """The reported position moves by rate (3,) [m/s]."""

    rate_m_s: Array

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        return p + np.outer(time_s, self.rate_m_s), F


@dataclass(frozen=True)
class Jump:
    """Somebody knocked the tracker: shifted (3,) [m] from a time on."""

    shift_m: Array
    time_s: float

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        return p + np.outer(time_s >= self.time_s, self.shift_m), F


@dataclass(frozen=True)
class Metal:
    """A piece of metal at `place_m` (3,): shifted by `shift_m` (3,) there, less with the distance over `width_m`."""

    shift_m: Array
    place_m: Array
    width_m: float

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        near = np.exp(-(((p - self.place_m) / self.width_m) ** 2).sum(axis=1) / 2)
        return p + np.outer(near, self.shift_m), F


@dataclass(frozen=True)
class Heading:
    """A sensor that reads `shift_m` (3,) too far times the square of its tangent's share along `axis` (3,)."""

    shift_m: Array
    axis: Array

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        return p + np.outer((F[:, :, 2] @ self.axis) ** 2, self.shift_m), F


@dataclass(frozen=True)
class Warm:
    """Shifted by rate (3,) [m/K] with the temperature of the room."""

    rate_m_K: Array
    room: Room

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        return p + np.outer(self.room.temperature_C(time_s) - 21.0, self.rate_m_K), F
