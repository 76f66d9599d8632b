"""What remains beside the effects that are supported: how large it is, how long it lasts, along which joints it is
smooth.

At rest an error goes along with the joints, or it is smooth in time. On a continuous motion it is forgotten with time,
exponentially or as a smooth function does, or it goes along with the joints. The error of a tangent is a small rotation
whose axes stay where they are: a tangent that turns shows other components of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import (
    POSITION,
    TANGENT,
    Block,
    Linearised,
    Numbered,
    Spectrum,
    block_of,
    decay,
)
from ctrplan.measurement.approach import clock, friction_state, last_directions
from ctrplan.measurement.measurements import Measurements

SCALES = (0.5, 1.0, 2.0)  # of a kernel, in rad of relative rotation or what counts as much
RIDGES = (0.1, 0.5, 2.0)  # noise of a kernel fit, over what it explains
ROOM_M = 0.05  # of translation, that counts as much as a radian, or as a friction state or direction
QUARTERS = 4.0  # of the experiment that count as much as a radian each


@dataclass(frozen=True)
class Remainder:
    """What nothing in the catalogue explains. Shares are of its variance, the noise's taken out."""

    rms_m: float  # of the distance, noise taken out
    memory: float | None  # [s] after which it has forgotten itself; None for poses at rest
    of_configuration: float  # share that a configuration has whenever it comes back
    of_history: float  # share that depends on how it was reached besides
    of_time: float  # share that changes with the time of the experiment besides
    place: str  # where it is, as a sentence
    memory_in_rows: bool = False  # of a log without times

    @property
    def sentence(self) -> str:
        """Size, memory and shares."""
        unit = "rows" if self.memory_in_rows else "s"
        lasting = "" if self.memory is None else f", which last {self.memory:.2g} {unit}"
        shares = [
            f"{100 * share:.0f} % {what}"
            for share, what in (
                (self.of_configuration, "belong to the configuration"),
                (self.of_history, "to how it was reached"),
                (self.of_time, "to the time"),
            )
            if share > 0.005
        ]
        fixed = f"Of their variance {', '.join(shares)}." if shares else "They go with nothing that comes back."
        return f"{self.rms_m * 1e3:.2f} mm remain (rms, noise taken out){lasting}. {fixed}"


def shares_of_motion(
    error_m: Array, data: Measurements, block: NDArray[np.int_], floor_m: float
) -> tuple[float, float, float]:
    """Shares of configuration, history and time in errors (K, 3), by what each adds when blocks (K,) are left out."""
    wanted = max(float((error_m**2).sum()) - len(error_m) * floor_m**2, 1e-12)
    features, explained = list[Array](), [0.0]
    for more in (_configuration(data), _history(data), _time(data)):
        features.append(more)
        explained.append(max(explained[-1], _explained(error_m, np.hstack(features), block)))
    configuration, history, time = (float(min(1.0, step / wanted)) for step in np.diff(explained))
    return configuration, history, time


def share_of_time(error_m: Array, data: Measurements, block: NDArray[np.int_], floor_m: float) -> float:
    """The share of time in errors (K, 3) of poses at rest."""
    wanted = max(float((error_m**2).sum()) - len(error_m) * floor_m**2, 1e-12)
    return float(min(1.0, max(0.0, _explained(error_m, _time(data), block)) / wanted))


def _configuration(data: Measurements) -> Array:
    turns = np.diff(data.theta_commanded[data.rows], axis=1)
    return np.hstack([np.sin(turns), np.cos(turns), data.l_commanded[data.rows] / ROOM_M])


def _history(data: Measurements) -> Array:
    states: Array = np.hstack([friction_state(data), last_directions(data)])
    return states


def _time(data: Measurements) -> Array:
    time = clock(data)
    since: Array = (time - time.min())[:, None] / max(float(np.ptp(time)), 1e-9) * QUARTERS
    return since


def _explained(error: Array, features: Array, block: NDArray[np.int_]) -> float:
    """Sum of squares that a smooth function of the features predicts of blocks it has not seen, the best of a few."""
    total = float((error**2).sum())
    square = ((features[:, None] - features[None]) ** 2).sum(axis=2)
    best: float = 0.0
    for scale in SCALES:
        kernel = np.exp(-square / (2 * scale**2 * features.shape[1]))
        for ridge in RIDGES:
            best = max(best, total - float(((error - _left_out(kernel, ridge, error, block)) ** 2).sum()))
    return best


def _left_out(kernel: Array, ridge: float, error: Array, block: NDArray[np.int_]) -> Array:
    """(K, 3) predictions of each block from the others: one inversion, (I - H_bb)^-1 per block."""
    smoother = kernel @ np.linalg.inv(kernel + ridge * np.eye(len(kernel)))
    predicted = smoother @ error
    for number in np.unique(block):
        rows = np.flatnonzero(block == number)
        own = np.eye(len(rows)) - smoother[np.ix_(rows, rows)]
        predicted[rows] = error[rows] - np.linalg.solve(own, error[rows] - predicted[rows])
    left: Array = predicted
    return left


JOINT_LENGTHS = (0.3, 0.6, 1.0, 1.5, 2.5)  # [rad]; longer ones are what frames and offsets are


def square_distances(data: Measurements, poses: Sequence[int]) -> Array:
    """(B, B) [rad^2] of configurations, each given by a pose: a chord for a rotation, 50 mm count as a radian."""
    rows = data.rows[list(poses)]
    theta, l = data.theta_commanded[rows], data.l_commanded[rows]  # noqa: E741
    turns = np.hstack([theta[:, :1], np.diff(theta, axis=1)])
    place = np.hstack([np.sin(turns), np.cos(turns), l / ROOM_M])
    square: Array = ((place[:, None] - place[None]) ** 2).sum(axis=2)
    return square


SMOOTH = (0.7, 1.0)  # share of what configurations differ by that goes along with the joints
MEMORIES = 6  # forgotten ones from a step of the poses to half of the motion, smooth ones from four to twice of it

Along = Literal["configuration", "joints", "time"]  # poses with like errors have the same of these, or are near in it


@dataclass(frozen=True, eq=False)
class SmoothError:
    """How the errors of poses go along with each other; numbers of a fit that do so, of position and of tangent."""

    along: Along
    position: tuple[Numbered, ...]
    tangent: tuple[Numbered, ...]

    def spectrum(self, fit: Linearised) -> Spectrum:
        """The spectrum of a fit of these poses beside the error, at every size."""
        return Spectrum.apart(fit, self.position, self.tangent)

    def at(self, fit: Linearised, position: float, tangent: float) -> Spectrum:
        """The fit beside the error at one size of each, over the noise."""
        return Spectrum.apart(fit, self.position, self.tangent, (np.array([position]), np.array([tangent])))


def at_rest(data: Measurements, share: float, axes: Array) -> list[SmoothError]:
    """Smooth errors of poses at rest, first of configurations that have nothing in common; share: of a
    configuration's approaches.

    axes (K, 2, 3) are those about which rotations are the two numbers of a tangent.
    """
    number, first, which = np.unique(data.configuration, return_index=True, return_inverse=True)
    square, own = square_distances(data, first.tolist()), np.eye(len(number))
    results = [own]
    kernels = [np.exp(-square / (2 * length**2)) for length in JOINT_LENGTHS[1:]]
    results += [(1 - q) * own + q * kernel for q, kernel in product(SMOOTH, kernels)]
    of_poses = [one[np.ix_(which.ravel(), which.ravel())] for one in results]
    of_poses = [share * one + (1 - share) * np.eye(data.count) for one in of_poses]
    one_by_one = _error("configuration", data, of_poses[0], axes)
    along_joints = [_error("joints", data, one, axes) for one in of_poses[1:]]
    slow = _smooth_in_time(clock(data), 0.5)  # what changes still more slowly is a drift
    in_time = [_error("time", data, one, axes) for one in slow]
    return [one_by_one, *along_joints, *in_time]


def of_motion(data: Measurements, axes: Array) -> list[SmoothError]:
    """Smooth errors of a continuous motion; axes (K, 2, 3) as of poses at rest."""
    return [_error(kind, data, one, axes) for kind, one in _correlations(data)]


def _error(along: Along, data: Measurements, correlation: Array, axes: Array) -> SmoothError:
    """With a correlation (K, K) of poses."""
    return SmoothError(along, tuple(_of_coordinates(data, correlation)), tuple(_of_rotations(data, correlation, axes)))


def _correlations(data: Measurements) -> Iterator[tuple[Along, Array]]:
    """What goes along, and (K, K) of the poses of a continuous motion."""
    time, together = clock(data), data.run[:, None] == data.run
    step, whole = _spans(time)
    for memory in np.geomspace(step, max(whole / 2, step), MEMORIES):
        yield "time", decay(time, memory) * together
    for one in _smooth_in_time(time, 2.0):
        yield "time", one * together
    square = square_distances(data, range(data.count))
    for length in JOINT_LENGTHS:
        yield "joints", np.exp(-square / (2 * length**2))


def _smooth_in_time(time: Array, longest: float) -> Iterator[Array]:
    """(K, K) of memories from four steps of the poses to `longest` times the whole."""
    step, whole = _spans(time)
    for memory in np.geomspace(4 * step, max(longest * whole, 4 * step), MEMORIES):
        yield np.exp(-((time[:, None] - time) ** 2) / (2 * memory**2))


def _spans(time: Array) -> tuple[float, float]:
    """The usual step between poses, and from the first to the last."""
    steps = np.diff(np.sort(time))
    return (float(np.median(steps[steps > 0])), float(np.ptp(time))) if steps.any() else (1.0, 1.0)


def _of_coordinates(data: Measurements, correlation: Array) -> Iterator[Numbered]:
    """Every coordinate of a position alike; those that were measured of the same poses at once."""
    given, numbers = data.given[:, POSITION], _numbers(data)[:, POSITION]
    masks, which = np.unique(given, axis=1, return_inverse=True)
    for k, mask in enumerate(masks.T):
        rows = np.flatnonzero(mask)
        if len(rows):
            yield numbers[np.ix_(rows, np.flatnonzero(which.ravel() == k))], _block(correlation[np.ix_(rows, rows)])


def _of_rotations(data: Measurements, correlation: Array, axes: Array) -> Iterator[Numbered]:
    """A rotation with its own axes, seen about those of each tangent."""
    seen: NDArray[np.bool_] = data.given[:, TANGENT]
    pose = np.nonzero(seen)[0]
    if len(pose):
        along = axes[seen]
        yield _numbers(data)[:, TANGENT][seen][:, None], _block((along @ along.T) * correlation[np.ix_(pose, pose)])


def _numbers(data: Measurements) -> NDArray[np.int_]:
    """(K, 5) where the numbers of the poses are in a fit's."""
    return np.arange(5 * data.count).reshape(-1, 5)


def _block(correlation: Array) -> Block:
    return block_of(np.arange(len(correlation)), correlation)
