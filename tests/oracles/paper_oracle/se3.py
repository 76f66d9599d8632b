"""SE(3): (2), (57), (73)-(75)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
E_Z = np.array([0.0, 0.0, 1.0])


def hat(v: Array) -> Array:
    """<v>: (..., 3) -> (..., 3, 3) with hat(v) @ w = v x w."""
    zero = np.zeros_like(v[..., 0])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape, 3)


def _coefficients(angle2: Array) -> tuple[Array, Array, Array, Array]:
    """beta/2, (1 - alpha)/|u|^2, (alpha - beta)/|u|^2, (beta/2 - 3 (1 - alpha)/|u|^2)/|u|^2 of (73)-(75), as series.

    The closed forms cancel at small |u|; an element turns by far less than 1 rad, where these are exact to 1e-13.
    """
    x = angle2
    return (
        1 / 2 - x / 24 + x**2 / 720 - x**3 / 40320 + x**4 / 3628800,
        1 / 6 - x / 120 + x**2 / 5040 - x**3 / 362880 + x**4 / 39916800,
        -1 / 12 + x / 180 - x**2 / 6720 + x**3 / 453600 - x**4 / 47900160,
        -1 / 60 + x / 1260 - x**2 / 60480 + x**3 / 4989600 - x**4 / 622702080,
    )


def dexp(u: Array) -> Array:
    """(73): differential of the exponential on SO(3), left-trivialised; u (..., 3) [rad]."""
    half_beta, second, _, _ = (c[..., None, None] for c in _coefficients((u * u).sum(-1)))
    U = hat(u)
    return np.eye(3) + half_beta * U + second * (U @ U)


def C(u: Array) -> Array:
    """(74) plus <e_z>/2: translation's share of the differential on SE(3); erratum: (72) lacks a factor Delta s."""
    half_beta, second, third, fourth = (c[..., None, None] for c in _coefficients((u * u).sum(-1)))
    U, Z, along = hat(u), hat(E_Z), u[..., 2, None, None]
    return half_beta * Z + second * (Z @ U + U @ Z) + third * along * U + fourth * along * (U @ U)


def exp(u: Array) -> Array:
    """exp(<u>): (..., 3) [rad] -> (..., 3, 3)."""
    return np.eye(3) + hat(u) @ dexp(u)


def rotation_z(angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
