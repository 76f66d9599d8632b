"""Contact and friction of one neighbouring pair: distances in the outer tube's normal plane.

Interior point: a station carries a multiplier lam > 0 and a gap w > 0 with w = (c^2 - |d|^2) / 2 and lam w = eps. On
the outer tube acts the force lam (d + phi mu t x d) and torque phi mu r_in lam |d|^2 / c about its tangent; on the
inner one the opposite force, and -phi mu r_out: equations (36) to (41) of Ha et al. 2019, |d| = c in contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden_effects.rod import Curve, Rod
from hidden_effects.tube import Array


@dataclass(frozen=True)
class Pair:
    """Radial clearance [m], Coulomb coefficient, radii [m] at which friction turns the outer and the inner tube."""

    clearance_m: float
    friction: float
    bore_radius_m: float
    inner_radius_m: float


@dataclass(frozen=True)
class Distances:
    """Offsets of the inner centreline in the outer tube's normal plane and how they move with the unknowns."""

    d: Array  # (M, 2)
    outer: Array  # (M, 2, 2N) minus sign included
    inner: Array  # (M, 2, 2N)
    plane: Array  # (M, 2, 3) rows that project displacements
    shift: Array  # (M,) from the station to the plane, along the inner tube


class Contact:
    """The stations shared by two rods."""

    def __init__(self, pair: Pair, outer: Rod, inner: Rod, s: Array) -> None:
        self.pair, self.rods = pair, (outer, inner)
        stations = np.arange(max(outer.first, inner.first), min(outer.last, inner.last) + 1)
        self.at = (stations - outer.first, stations - inner.first)
        self.s = s[stations]
        self.share = np.zeros(len(stations))
        self.share[1:] += np.diff(self.s) / 2
        self.share[:-1] += np.diff(self.s) / 2
        bore, radius = pair.bore_radius_m, pair.inner_radius_m
        self.twist = (bore * outer.twist_at[self.at[0]], -radius * inner.twist_at[self.at[1]])

    def distances(self, outer: Curve, inner: Curve) -> Distances:
        a, b = self.at
        t, t_in = outer.Q[a, :, 2], inner.Q[b, :, 2]
        basis = np.swapaxes(outer.Q[a, :, :2], 1, 2)  # (M, 2, 3)
        apart = inner.p[b] - outer.p[a]
        cosine = np.sum(t * t_in, axis=1)
        shift = -np.sum(t * apart, axis=1) / cosine
        plane = basis - (basis @ t_in[:, :, None]) * (t / cosine[:, None])[:, None, :]
        d = (basis @ (apart + shift[:, None] * t_in)[:, :, None])[:, :, 0]
        moved = inner.moved[b] - skew_times(shift[:, None] * t_in, inner.turned[b])
        return Distances(d, -plane @ outer.moved[a], plane @ moved, plane, shift)

    def torques(self, outer: Curve, inner: Curve) -> tuple[Array, Array]:
        """Rows (M, 2N + N') by which a unit of phi mu force works on the rotations of the outer and the inner tube."""
        rows = []
        for curve, at, twist, radius in (
            (outer, self.at[0], self.twist[0], self.pair.bore_radius_m),
            (inner, self.at[1], self.twist[1], -self.pair.inner_radius_m),
        ):
            roll = radius * np.einsum("ki,kin->kn", curve.Q[at, :, 2], curve.turned[at])
            rows.append(np.concatenate([roll, twist], axis=1))
        return rows[0], rows[1]


def skew_times(a: Array, table: Array) -> Array:
    """a (M, 3) cross the columns of table (M, 3, N)."""
    x, y, z = a[:, 0, None], a[:, 1, None], a[:, 2, None]
    return np.stack(
        [
            y * table[:, 2] - z * table[:, 1],
            z * table[:, 0] - x * table[:, 2],
            x * table[:, 1] - y * table[:, 0],
        ],
        axis=1,
    )
