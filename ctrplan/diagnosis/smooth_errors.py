"""Smooth errors that poses may have besides: all kinds and smoothnesses that the evidence of a set is asked beside.

At rest an error goes along with the joints, or it is smooth in time. On a continuous motion it is forgotten with time,
exponentially or as a smooth function does, or it goes along with the joints. The error of a tangent is a small rotation
whose axes stay where they are: a tangent that turns shows other components of it.
"""

from __future__ import annotations

from collections.abc import Iterator
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
    SizePart,
    Spectrum,
    block_of,
    decay,
)
from ctrplan.diagnosis.joint_memory import square_distances
from ctrplan.experiment.measurements import Measurements
from ctrplan.experiment.motion import clock

LENGTHS = (0.6, 1.0, 1.5, 2.5)  # [rad] of joints
SMOOTH = (0.7, 1.0)  # share of what configurations differ by that goes along with the joints
LENGTHS_OF_MOTION = (0.3, *LENGTHS)
MEMORIES = 5  # forgotten ones from a step of the poses to half of the motion, smooth ones from four to twice of it
MEMORIES_AT_REST = 6  # smooth ones from four steps to half of the time: what changes more slowly is a drift

Along = Literal["configuration", "joints", "time"]  # poses with like errors have the same of these, or are near in it


@dataclass(frozen=True, eq=False)
class SmoothError:
    """How the errors of poses go along with each other; numbers of a fit that do so, of position and of tangent."""

    along: Along
    position: tuple[Numbered, ...]
    tangent: tuple[Numbered, ...]

    def spectrum(self, fit: Linearised) -> Spectrum:
        """Of a fit of these poses beside it, at every size."""
        return Spectrum.apart(fit, self.position, self.tangent)

    def at(self, fit: Linearised, position: float, tangent: float) -> tuple[SizePart, SizePart]:
        """The same at one size of each, over the noise."""
        spectrum = Spectrum.apart(fit, self.position, self.tangent, ([position], [tangent]))
        return spectrum.position[0], spectrum.tangent[0]


def at_rest(data: Measurements, share: float, axes: Array) -> list[SmoothError]:
    """Of poses at rest, first of configurations that have nothing in common; share: of a configuration's approaches.

    axes (K, 2, 3) are those about which rotations are the two numbers of a tangent.
    """
    number, first, which = np.unique(data.configuration, return_index=True, return_inverse=True)
    square, own = square_distances(data, first.tolist()), np.eye(len(number))
    found = [own]
    found += [(1 - q) * own + q * np.exp(-square / (2 * length**2)) for q, length in product(SMOOTH, LENGTHS)]
    of_poses = [one[np.ix_(which.ravel(), which.ravel())] for one in found]
    of_poses = [share * one + (1 - share) * np.eye(data.count) for one in of_poses]
    one_by_one = _error("configuration", data, of_poses[0], axes)
    along_joints = [_error("joints", data, one, axes) for one in of_poses[1:]]
    in_time = [_error("time", data, one, axes) for one in _smooth_in_time(clock(data), MEMORIES_AT_REST, 0.5)]
    return [one_by_one, *along_joints, *in_time]


def of_motion(data: Measurements, axes: Array) -> list[SmoothError]:
    """Of a continuous motion; axes (K, 2, 3) as of poses at rest."""
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
    for one in _smooth_in_time(time, MEMORIES, 2.0):
        yield "time", one * together
    square = square_distances(data, range(data.count))
    for length in LENGTHS_OF_MOTION:
        yield "joints", np.exp(-square / (2 * length**2))


def _smooth_in_time(time: Array, count: int, longest: float) -> Iterator[Array]:
    """(K, K) of memories from four steps of the poses to `longest` times the whole."""
    step, whole = _spans(time)
    for memory in np.geomspace(4 * step, max(longest * whole, 4 * step), count):
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
