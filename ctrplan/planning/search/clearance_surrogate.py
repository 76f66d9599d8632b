"""What a search expects of states that it has not solved, by the room around their zero-clearance shapes.

Friction and the clearance between tubes move shapes by millimetres, so that less clearance is left than that room. How
much less changes slowly over joint space: it is a Gaussian process there, which every solved state teaches.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import ndtr

from ctrplan.base.arrays import Array
from ctrplan.scenario.joint_space import JointSpace

# What is lost of the room [m] before any state near is solved, its standard deviation, how far neighbours differ at
# least, and the joint length [mm] over which it changes: of greatest marginal likelihood for 1,322 states that twelve
# searches of two scenarios solved.
LOSS_M, LOSS_SD_M, SCATTER_M, LOSS_MM = 1e-3, 2e-3, 0.2e-3, 30.0


def expected_share(room_m: Array) -> Array:
    """Share of states that leave any clearance, by their rooms [m], before any near them is solved."""
    return _share_valid(room_m, np.full(len(room_m), LOSS_M), np.full(len(room_m), LOSS_SD_M**2))


class ClearanceSurrogate:
    """The probability that places in joint space leave any clearance, given what was solved.

    The covariance of what two places lose falls with the distance between them (Matern, of smoothness 3/2), rotations
    counted as chords, so that it is one for any number of turns. Each solved place is a row of the Cholesky factor of
    all covariances, continued to places that are not solved.
    """

    def __init__(self, space: JointSpace) -> None:
        """Nothing is solved yet."""
        self.space = space
        self.joints: Array = np.empty((0, len(space.weights_mm)))
        self.room_m: Array = np.empty(0)
        self.loss_m: Array = np.empty(0)  # expected
        self.variance: Array = np.empty(0)  # [m^2]
        self._at_mm = self._embedded(self.joints)
        self._solved: list[int] = []  # numbers of N places
        self._deviation_m: Array = np.empty(0)  # (N,) that was expected there
        self._surprise: Array = np.empty(0)  # (N,) of what was solved, in deviations
        self._rows: Array = np.empty((0, 0))  # (N, M) of solved places, to all [m]

    def extend(self, joints: Array, room_m: Array) -> NDArray[np.int_]:
        """Adds places (K, m) with their rooms (K,) [m]; returns their numbers (K,)."""
        rows = self._continued(joints)
        loss_m, variance = self._expected(rows)
        self.joints, self.room_m = np.concatenate([self.joints, joints]), np.concatenate([self.room_m, room_m])
        self._at_mm = np.concatenate([self._at_mm, self._embedded(joints)])
        self.loss_m, self.variance = np.append(self.loss_m, loss_m), np.append(self.variance, variance)
        self._rows = np.concatenate([self._rows, rows], axis=1)
        return np.arange(len(self.room_m) - len(joints), len(self.room_m))

    def learn(self, place: int, clearance_m: float) -> None:
        """Takes in what a solved place leaves; nothing of one where that is not known."""
        if not np.isfinite(self.room_m[place] - clearance_m) or place in self._solved:
            return
        deviation_m = np.sqrt(self.variance[place] + SCATTER_M**2)
        surprise = (self.room_m[place] - clearance_m - self.loss_m[place]) / deviation_m
        row = (_covariance(self._at_mm[[place]], self._at_mm)[0] - self._rows[:, place] @ self._rows) / deviation_m
        self.loss_m, self.variance = self.loss_m + surprise * row, self.variance - row**2
        self._rows, self._surprise = np.concatenate([self._rows, row[None]]), np.append(self._surprise, surprise)
        self._deviation_m = np.append(self._deviation_m, deviation_m)
        self._solved.append(place)

    def share_valid(self) -> Array:
        """(M,) probability that a place leaves any clearance."""
        return _share_valid(self.room_m, self.loss_m, self.variance)

    def share_valid_at(self, joints: Array, room_m: Array) -> Array:
        """(K,) that of other places (K, m) with their rooms (K,) [m]."""
        return _share_valid(room_m, *self._expected(self._continued(joints)))

    def _continued(self, joints: Array) -> Array:
        """(N, K) [m] rows to other places (K, m)."""
        if not self._solved:
            return np.empty((0, len(joints)))
        factor = self._rows[:, self._solved].T.copy()
        np.fill_diagonal(factor, self._deviation_m)
        across = _covariance(self._at_mm[self._solved], self._embedded(joints))
        return np.asarray(solve_triangular(factor, across, lower=True))

    def _expected(self, rows: Array) -> tuple[Array, Array]:
        """What places with rows (N, K) lose (K,) [m], and its variance (K,) [m^2]."""
        return LOSS_M + self._surprise @ rows, LOSS_SD_M**2 - (rows**2).sum(axis=0)

    def _embedded(self, joints: Array) -> Array:
        """(K, E) [mm] coordinates in which distances are those of joint values (K, m), rotations as chords."""
        turns, scaled = self.space.drive.is_rotation, joints * self.space.weights_mm
        radius_mm = self.space.weights_mm[turns]
        angles = joints[:, turns]
        return np.concatenate([radius_mm * np.cos(angles), radius_mm * np.sin(angles), scaled[:, ~turns]], axis=1)


def _covariance(a_mm: Array, b_mm: Array) -> Array:
    """(A, B) [m^2] of what embedded places (A, E) and (B, E) lose."""
    scaled = np.sqrt(3) / LOSS_MM * np.linalg.norm(a_mm[:, None] - b_mm, axis=2)
    return np.asarray(LOSS_SD_M**2 * (1 + scaled) * np.exp(-scaled))


def _share_valid(room_m: Array, loss_m: Array, variance: Array) -> Array:
    return np.asarray(ndtr((room_m - loss_m) / np.sqrt(np.maximum(variance, 0.0) + SCATTER_M**2)))
