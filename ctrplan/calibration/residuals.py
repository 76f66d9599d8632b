"""Differences of measured and predicted poses over the noise, and how positions and tangents are weighed.

A pose has five numbers: three of its position, over the standard deviation of a coordinate, and the two components of
the measured tangent in the plane normal to the predicted one, over the standard deviation of a small rotation. Of a
tangent seen along an axis it is one: how far the predicted tangent is turned out of the plane of sight; one along the
line of sight says nothing. What was not measured is zero, changes with no parameter, and counts nowhere: `given`.
Poses of one point in one configuration share the model's own numerical error; their common part counts for less
accordingly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Discrepancy
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import SensorPrediction
from ctrplan.robot.robot import Robot

PER_POSE = 5
MODEL_POSITION_M, MODEL_TANGENT_RAD = 0.05e-3, np.radians(0.05)  # of the solver, docs/model.md
ROBUST_LIMIT = 4.5  # norm of a pose's five numbers beyond which it is down-weighted; 0.1 % of Gaussian ones
UNSOUND = 20.0  # norm given to a pose that the model could not solve


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a coordinate of the position and of a small rotation of the tangent about an axis.

    Where poses have a discrepancy besides, `discrepancy` is that of the poses that are asked about, in their order.
    """

    position_m: float
    tangent_rad: float
    discrepancy: Discrepancy | None = None

    @property
    def floor_m(self) -> float:
        """Rms distance of measured positions from a perfect model."""
        return float(self.position_m * np.sqrt(3.0))

    def scaled(self, factor: float) -> Noise:
        """Noise of another size."""
        return Noise(self.position_m * factor, self.tangent_rad * factor)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Whitened differences r (K, 5), measured minus predicted, and derivatives of the prediction J (K, 5, P)."""

    r: Array
    J: Array
    weight: Array  # (K,) 1, less for outliers
    raw_norm: Array  # (K,) norm of each pose's five numbers before those of its configuration took their part
    given: NDArray[np.bool_]  # (K, 5) numbers that were measured; the others are zero in r and J

    @property
    def norm(self) -> Array:
        """(K,) of each pose."""
        norm: Array = np.linalg.norm(self.r, axis=1)
        return norm

    @property
    def loss(self) -> float:
        """Sum over poses of squares, linear beyond the robust limit."""
        return float(robust_square(self.norm).sum())


def robust_square(norm: Array) -> Array:
    """Huber's loss of norms, (K,)."""
    c = ROBUST_LIMIT
    square: Array = np.where(norm <= c, norm**2, 2 * c * norm - c * c)
    return square


def residuals(
    data: Measurements, prediction: SensorPrediction, noise: Noise, group: Sequence[int] | NDArray[np.int_]
) -> Residuals:
    """Residuals of all poses; `group` (K,) numbers the configurations."""
    given = data.given
    measured, plane = compared(prediction.tangent, data.tangent)
    sigma_m = noise.position_m * data.over_tip
    position = np.where(given[:, :3], (data.position_m - prediction.position_m) / sigma_m, 0.0)
    tangent = np.where(given[:, 3:], _tangent_error(prediction.tangent, measured, plane) / noise.tangent_rad, 0.0)
    position_by = prediction.position_by / sigma_m[:, :, None] * given[:, :3, None]
    tangent_by = np.einsum("kcx,kxp->kcp", plane, prediction.tangent_by) / noise.tangent_rad * given[:, 3:, None]
    r = np.hstack([position, tangent])
    J = np.concatenate([position_by, tangent_by], axis=1)
    shares = np.repeat([MODEL_POSITION_M / noise.position_m, MODEL_TANGENT_RAD / noise.tangent_rad], [3, 2])
    r, J = _unsound(r, J, prediction.sound, given)
    raw_norm = np.linalg.norm(r, axis=1)
    trust = _weight(raw_norm)[:, None] * given
    alike = np.asarray(group) * (int(data.seen_marker.max(initial=0)) + 1) + data.seen_marker
    r, J = _whitened(r, alike, shares, trust), _whitened(J, alike, shares[:, None], trust)
    if noise.discrepancy is not None:
        r, J = noise.discrepancy.whitened(r), noise.discrepancy.whitened(J)
    return Residuals(r, J, _weight(np.linalg.norm(r, axis=1)), raw_norm, given)


def _weight(norm: Array) -> Array:
    """Huber's weights of norms, (K,)."""
    weight: Array = np.minimum(1.0, ROBUST_LIMIT / np.maximum(norm, 1e-12))
    return weight


def compared(tangent: Array, measured: Array) -> tuple[Array, Array]:
    """Measured tangents (K, 3) and the axes (K, 2, 3) along which predicted ones are compared with them.

    A tangent without one component is completed by the predicted one's, which leaves the angle between the two in the
    plane that was seen, times the share of the predicted tangent in that plane.
    """
    missing = ~np.isfinite(measured)
    seen = np.where(missing, 0.0, measured)
    flat = missing.sum(axis=1) == 1
    inside = np.linalg.norm(np.where(missing, 0.0, tangent), axis=1, keepdims=True)
    seen = np.where(flat[:, None], np.where(missing, tangent, inside * seen), seen)
    whole = np.where((missing.sum(axis=1) > 1)[:, None], tangent, seen)
    plane = _normal_plane(tangent, whole)
    sight = np.cross(missing.astype(float), whole)  # across the line of sight and the measured direction
    across = sight - np.sum(sight * tangent, axis=1, keepdims=True) * tangent
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    plane[flat, 0] = across[flat]
    return whole, plane


def _normal_plane(tangent: Array, measured: Array) -> Array:
    """(K, 2, 3) axes across the predicted tangents, turned the same way for all predictions of a measured one."""
    axis = np.eye(3)[np.argmin(np.abs(measured), axis=1)]
    first = axis - np.sum(axis * tangent, axis=1, keepdims=True) * tangent
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(tangent, first)], axis=1)


def _tangent_error(tangent: Array, measured: Array, plane: Array) -> Array:
    """(K, 2) rotation [rad] from predicted to measured tangent, as a vector across the predicted one."""
    across = np.einsum("kcx,kx->kc", plane, measured)
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, np.sum(tangent * measured, axis=1))
    error: Array = across * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)[:, None]
    return error


def _whitened(values: Array, group: NDArray[np.int_], share: Array, trust: Array) -> Array:
    """Unit covariance after 1 + share^2 within groups: the mean of a group of m shrinks by 1 / sqrt(1 + m share^2).

    `trust` (K, 5) keeps an outlier, and what was not measured, out of the mean that its neighbours share.
    """
    numbers, number = np.unique(group, return_inverse=True)
    column = trust.reshape(*trust.shape, *[1] * (values.ndim - 2))
    sums, m = np.zeros((len(numbers), *values.shape[1:])), np.zeros((len(numbers), *column.shape[1:]))
    np.add.at(sums, number, column * values)
    np.add.at(m, number, column)
    pull = (1 - 1 / np.sqrt(1 + m * share**2)) * sums / np.maximum(m, 1e-12)
    whitened: Array = values - np.where(column > 0, pull[number], 0.0)
    return whitened


def _unsound(r: Array, J: Array, sound: NDArray[np.bool_], given: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Poses that were not solved carry a large residual that no parameter changes."""
    r, J = np.nan_to_num(r), np.nan_to_num(J)
    r[~sound], J[~sound] = (UNSOUND * given / np.sqrt(given.sum(axis=1, keepdims=True)))[~sound], 0.0
    return r, J


def information_inverse(J: Array, weight: Array, precision: Array) -> Array:
    """(P, P) matrix A with A A^T the covariance of parameters with derivatives J (K, 5, P) and priors."""
    flat = J.reshape(-1, J.shape[2])
    H = flat.T @ (np.repeat(weight, J.shape[1])[:, None] * flat) + np.diag(precision)
    scale = 1 / np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    root: Array = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-14 * values.max()))
    return root


Weighting = Literal["stated", "paper"]

PAPER = Noise(1e-3, float(np.radians(1.0)))  # 1 deg of the tangent weighs as much as 1 mm, text at (49)
NO_TANGENT_SIGMA = "is missing, needed for the tangents of these measurements"


def weighed_by(robot: Robot, data: Measurements, weighting: Weighting | None) -> Noise:
    """The noise that residuals are divided by, the paper's where none is stated. Raises InputError if it must be."""
    stated = robot.measurement
    if weighting == "stated" and stated is None:
        raise InputError("is missing, needed for weights from the stated noise", file=robot.path, key="measurement")
    if stated is None or weighting == "paper":
        return PAPER
    if stated.tangent_sigma_rad is None and data.has_tangents:
        raise InputError(NO_TANGENT_SIGMA, file=robot.path, key="measurement.tangent_sigma_deg")
    return Noise(stated.position_sigma_m, stated.tangent_sigma_rad or PAPER.tangent_rad)
