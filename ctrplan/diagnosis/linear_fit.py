"""A fit linearised around its place: one step from there, what it says of poses left out, how wide its priors are."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, lapack

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Linearised
from ctrplan.calibration.residuals import PER_POSE, Noise

MOST_ITERATIONS, SETTLED = 10, 0.1  # of widths, whose logarithm changes no more: a tenth of what they are known to


@dataclass(frozen=True, eq=False)
class Linear:
    """A linearised fit: whitened residuals r (K, 5), derivatives J (K, 5, P), weights (K,), prior precision (P,)."""

    r: Array
    J: Array
    weight: Array
    precision: Array
    offset: Array  # (P,) distance of the parameters from the priors' centres
    given: NDArray[np.bool_]  # (K, 5) numbers that were measured; the others are zero in r and J

    def columns(self, chosen: list[int]) -> Linear:
        """The fit with some of the parameters only."""
        return replace(self, J=self.J[:, :, chosen], precision=self.precision[chosen], offset=self.offset[chosen])

    def without(self, gone: NDArray[np.bool_]) -> Linear:
        """With some of the parameters, mask (P,), back at the priors' centres, and no longer fitted."""
        back = replace(self, r=self.r + self.J[:, :, gone] @ self.offset[gone])
        return back.columns(np.flatnonzero(~gone).tolist())

    def beside(self, columns: Array) -> Linear:
        """With columns (K, 5, D) besides, of parameters without priors."""
        more = np.zeros(columns.shape[2])
        J, precision = np.concatenate([self.J, columns], axis=2), np.concatenate([self.precision, more])
        return replace(self, J=J, precision=precision, offset=np.concatenate([self.offset, more]))

    @property
    def loss(self) -> float:
        """Loss of the poses and of the priors, with weights as they are."""
        return float(self.weight @ (self.r**2).sum(axis=1) + self.precision @ self.offset**2)

    @property
    def evidence(self) -> float:
        """Logarithm of the evidence with weights as they are, up to what is the same for all fits of the poses."""
        volume = float(np.linalg.slogdet(self.information)[1]) - float(np.log(self.precision).sum())
        return -(self.loss + volume) / 2

    def refitted(self) -> Linear:
        """After one Gauss-Newton step."""
        step = solved(self.information, self.gradient - self.precision * self.offset)
        return replace(self, r=self.r - self.J @ step, offset=self.offset + step)

    def widened(self, owners: Sequence[str], widths: Mapping[str, Width]) -> Linear:
        """With priors as wide as is most probable for the effects that own the parameters."""
        over_stated = np.square([widths.get(name, STATED).over_stated for name in owners])
        return replace(self, precision=self.precision / over_stated)

    def centred(self, noise: Noise, root: Array) -> Linearised:
        """Residuals at the priors' centres over the noise alone, as poses count: by roots (K,)."""
        seen = self.coloured(noise)
        return Linearised(root[:, None] * (seen.r + seen.J @ self.offset), root[:, None, None] * seen.J, self.precision)

    def coloured(self, noise: Noise) -> Linear:
        """The fit over the noise alone, without the discrepancy that it was fitted beside."""
        if (rest := noise.discrepancy) is None:
            return self
        return replace(self, r=rest.coloured(self.r), J=rest.coloured(self.J))

    @property
    def information(self) -> Array:
        """(P, P) of the poses and of the priors."""
        return self._times(self.J) + np.diag(self.precision)

    @property
    def gradient(self) -> Array:
        """(P,) of the poses."""
        return self._times(self.r[:, :, None])[:, 0]

    def _times(self, values: Array) -> Array:
        """(P, ...) derivatives with numbers (K, 5, ...) as poses count."""
        J, w = self.J.reshape(-1, self.J.shape[2]), np.repeat(self.weight, PER_POSE)[:, None]
        products: Array = J.T @ (w * values.reshape(len(w), -1))
        return products


def predicted(r: Array, J: Array, information: Array) -> tuple[float, float]:
    """Chi-square and log density of residuals (R,) with derivatives (R, P), of numbers that no fit has seen.

    Over noise and the uncertainty that a fit of some information (P, P) leaves in its parameters, by Woodbury's
    identity.
    """
    whole, along = information + J.T @ J, J.T @ r
    square = float(r @ r - along @ solved(whole, along))
    return square, -(square + float(np.linalg.slogdet(whole)[1] - np.linalg.slogdet(information)[1])) / 2


def left_out_residuals(fit: Linear, group: NDArray[np.int_]) -> Array:
    """(K, 5) residuals of every pose when its group (K,) had not been fitted.

    With r = y - J p and H = J^T W J + prior, those of a group move to r_g + J_g (H - J_g^T W J_g)^-1 J_g^T W r_g.
    """
    H = fit.information
    left = np.empty_like(fit.r)
    for number in np.unique(group):
        inside = group == number
        J, r, w = fit.J[inside].reshape(-1, len(H)), fit.r[inside].ravel(), np.repeat(fit.weight[inside], PER_POSE)
        moved = r + J @ solved(H - J.T @ (w[:, None] * J), J.T @ (w * r))
        left[inside] = moved.reshape(-1, PER_POSE)
    return left


def solved(matrix: Array, right: Array) -> Array:
    """For a symmetric matrix whose rows may differ by many orders of magnitude."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix * np.outer(scale, scale)
    shaped = scale if right.ndim == 1 else scale[:, None]
    try:
        solved: Array = shaped * cho_solve(cho_factor(scaled, check_finite=False), shaped * right, check_finite=False)
    except np.linalg.LinAlgError:  # not positive definite by rounding: what nothing determines stays where it is
        solved = shaped * np.linalg.lstsq(scaled, shaped * right, rcond=1e-13)[0]
    return solved


@dataclass(frozen=True)
class Width:
    """How wide an effect's prior most probably is, and the logarithm of what it costs to choose it."""

    over_stated: float
    cost: float

    @classmethod
    def of(cls, square: Array, unknown: Array) -> Width:
        """From k parameters' expected squares (k,) over the stated variances, and the shares of these that poses leave.

        The k numbers have the density w^-k exp(-S / 2 w^2), S their sum, and log w that of w / (1 + w^2). What the
        prior alone says of k parameters is no knowledge of w: the curvature counts those that poses determine.
        """
        k, total = len(square), float(square.sum())
        half = (total + 1 - k) / 2
        variance = (half + np.sqrt(half**2 + (k + 1) * total)) / (k + 1)
        curvature = 2 * (k - float(unknown.sum())) + 4 * variance / (1 + variance) ** 2
        density = 2 / np.pi * np.sqrt(variance) / (1 + variance)
        return cls(float(np.sqrt(variance)), -float(np.log(density * np.sqrt(2 * np.pi / curvature))))


STATED = Width(1.0, 0.0)  # of what has no parameters, and of the base's


def widths_of(fit: Linear, owners: Sequence[str], named: Collection[str]) -> dict[str, Width]:
    """How wide each effect's prior most probably is, its parameters integrated out.

    By expectation and maximisation, which never lowers the posterior of the logarithms of the widths.
    """
    data = fit.information - np.diag(fit.precision)
    target, of = fit.gradient + data @ fit.offset, np.array(owners)
    places = {name: np.flatnonzero(of == name) for name in sorted(named) if name in owners}
    widths = dict.fromkeys(places, STATED)
    for _ in range(MOST_ITERATIONS):
        precision = fit.precision / np.square([widths.get(name, STATED).over_stated for name in owners])
        scale = 1 / np.sqrt(np.diag(data) + precision)
        covariance = np.linalg.inv((data + np.diag(precision)) * np.outer(scale, scale)) * np.outer(scale, scale)
        variance = np.diag(covariance)
        square, unknown = ((covariance @ target) ** 2 + variance) * fit.precision, variance * precision
        before, widths = widths, {name: Width.of(square[own], unknown[own]) for name, own in places.items()}
        if all(abs(np.log(widths[name].over_stated / before[name].over_stated)) < SETTLED for name in widths):
            break
    return widths


def process_gains(systems: Sequence[tuple[Array, Array]], sizes: Array) -> Array:
    """(M, S) what M processes B multiply the evidence by, its logarithm, by B^T S B (m, m) and B^T S r (m,) of each.

    S leaves what a fit does not explain. By the pivots of I + s^2 B^T S B where B^T S B is tridiagonal.
    """
    lines = [_tridiagonal(*system) for system in systems]
    square, longest = sizes**2, max((len(diagonal) for diagonal, _ in lines), default=0)
    a, b = np.zeros((2, longest, len(lines), 1))
    for k, (diagonal, beside) in enumerate(lines):
        a[longest - len(diagonal) :, k, 0], b[longest - len(beside) + 1 :, k, 0] = diagonal, beside[:-1] ** 2
    pivot, volume = np.ones((len(lines), len(square))), np.zeros((len(lines), len(square)))
    for diagonal, before in zip(a, b, strict=True):
        pivot = 1 + square * diagonal - square**2 * before / pivot
        volume += np.log(pivot)
    length = np.array([beside[-1] for _, beside in lines])[:, None]
    gains: Array = (square * length**2 / pivot - volume) / 2
    return gains


def _tridiagonal(square: Array, along: Array) -> tuple[Array, Array]:
    """The diagonal (m,) of a symmetric matrix (m, m) in axes where it is tridiagonal, the last along a vector (m,).

    And what stands beside the diagonal (m - 1,), with the length of the vector after it.
    """
    bordered = np.zeros((len(along) + 1, len(along) + 1), order="F")
    bordered[:-1, :-1], bordered[:-1, -1] = square, along
    _, diagonal, beside, _, _ = lapack.dsytrd(bordered, lower=0, overwrite_a=1)
    return diagonal[:-1], beside
