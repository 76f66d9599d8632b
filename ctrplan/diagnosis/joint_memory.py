"""How far errors of poses at rest go along with the joints: configurations that are near each other have alike ones.

Of a residual over the noise, the means over the approaches of a configuration have the covariance
n^2 + v ((1 - q) I + q K), K = exp(-d^2 / (2 length^2)) with d the distance of two configurations in rad of joints, n
the noise of a mean, and v what configurations differ by besides. q and the length are the most probable ones, with all
parameters integrated out over their priors: a fit takes much of what is smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import POSITION, TANGENT, Discrepancy, Linearised
from ctrplan.diagnosis.rest import ROOM_M
from ctrplan.experiment.measurements import Measurements

LENGTHS = (0.3, 0.6, 1.0, 1.5, 2.5)  # [rad]; longer ones are what frames and offsets are
SMOOTH = (0.0, 0.5, 0.8, 0.95, 1.0)  # of q


@dataclass(frozen=True, eq=False)
class JointMemory:
    """Symmetric roots (B, B) of the covariances of means, of a coordinate of the position and of the tangent."""

    position: Array
    tangent: Array
    length: float  # [rad]
    smooth: float  # q
    correlation: Array  # (K, K) of the poses, 1 within a configuration

    def whitened(self, means: Array) -> Array:
        """(B, 5) means over their own covariance."""
        return np.hstack([np.linalg.solve(root, means[:, part]) for root, part in self._parts])

    def coloured(self, means: Array) -> Array:
        """The inverse of `whitened`."""
        return np.hstack([root @ means[:, part] for root, part in self._parts])

    @property
    def _parts(self) -> list[tuple[Array, slice]]:
        return [(self.position, POSITION), (self.tangent, TANGENT)]


def joint_memory(fit: Linearised, data: Measurements, found: Discrepancy) -> JointMemory:
    """The most probable one of what remains of a fit, over the noise, beside a discrepancy of its configurations."""
    members = [np.flatnonzero(data.configuration == number) for number in np.unique(data.configuration)]
    means = Linearised(
        np.array([fit.r[rows].mean(axis=0) for rows in members]),
        np.array([fit.J[rows].mean(axis=0) for rows in members]),
        fit.precision,
    )
    square = square_distances(data, [int(rows[0]) for rows in members])
    count = np.array([len(rows) for rows in members])
    best: JointMemory | None = None
    highest = -np.inf
    for smooth, length in product(SMOOTH, LENGTHS):
        correlation = (1 - smooth) * np.eye(len(members)) + smooth * np.exp(-square / (2 * length**2))
        covariances = [_covariance(size, found.memory, count, correlation) for size in (found.position, found.tangent)]
        value = _evidence(means, covariances)
        if value > highest:
            which = np.unique(data.configuration, return_inverse=True)[1].ravel()
            best = JointMemory(
                _root(covariances[0]), _root(covariances[1]), length, smooth, correlation[np.ix_(which, which)]
            )
            highest = value
    assert best is not None
    return best


def square_distances(data: Measurements, poses: Sequence[int]) -> Array:
    """(B, B) [rad^2] of configurations, each given by a pose: a chord for a rotation, 50 mm count as a radian."""
    rows = data.rows[list(poses)]
    theta, l = data.theta_commanded[rows], data.l_commanded[rows]  # noqa: E741
    turns = np.hstack([theta[:, :1], np.diff(theta, axis=1)])
    place = np.hstack([np.sin(turns), np.cos(turns), l / ROOM_M])
    square: Array = ((place[:, None] - place[None]) ** 2).sum(axis=2)
    return square


def _covariance(size: float, share: float, count: NDArray[np.int_], correlation: Array) -> Array:
    """(B, B) of the means over `count` (B,) approaches, `share` of a variance of size^2 the configurations'."""
    of_mean: Array = np.diag((1 + size**2 * (1 - share)) / count) + size**2 * share * correlation
    return of_mean


def _root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    root: Array = (vectors * np.sqrt(np.maximum(values, 1e-12))) @ vectors.T
    return root


def _evidence(means: Linearised, covariances: Sequence[Array]) -> float:
    """Twice the logarithm of it, up to a constant."""
    H, gradient, fits = np.diag(means.precision), np.zeros(len(means.precision)), 0.0
    for covariance, part in zip(covariances, (POSITION, TANGENT), strict=True):
        r, J = means.r[:, part], means.J[:, part]
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.solve(factor, r)
        by = np.linalg.solve(factor, J.reshape(len(J), -1)).reshape(-1, J.shape[2])
        H, gradient = H + by.T @ by, gradient + by.T @ white.ravel()
        fits -= float((white**2).sum()) + 2 * r.shape[1] * float(np.log(np.diag(factor)).sum())
    scale = 1 / np.sqrt(means.precision)
    factor = np.linalg.cholesky(H * np.outer(scale, scale))
    z = np.linalg.solve(factor, scale * gradient)
    return fits + float(z @ z - 2 * np.log(np.diag(factor)).sum())
