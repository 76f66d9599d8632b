"""The discretised robot at one configuration: Sections II-A to II-C."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from paper_oracle.rod import jacobians, rod_of
from paper_oracle.se3 import Array
from paper_oracle.tubes import Tube


@dataclass(frozen=True, eq=False)
class Contacts:
    """Every place where (14) is demanded: M nodes where tube i and tube i + 1 both exist."""

    pair: NDArray[np.int_]  # (M,) i, from 0
    node: NDArray[np.int_]  # (M,) of the mesh
    outer: NDArray[np.int_]  # (M,) row of p_i(s_ij) among all nodes of all tubes: S_k of (21)
    inner: NDArray[np.int_]  # (M,) row of p_{i+1}(s_ij)
    clearance: Array  # (M,) radial c_i (15) [m]
    eta_mu: Array  # (M,) eta_k mu_k
    r_in: Array  # (M,) inner radius of tube i [m]
    r_out: Array  # (M,) outer radius of tube i + 1 [m]
    force_scale: Array  # (M,) expected force [N], see Problem


class Problem:
    """The vector-space problem of Section II-C for one configuration; E elements of all tubes together, M contacts."""

    def __init__(
        self,
        tubes: Sequence[Tube],
        clearance_m: ArrayLike,
        friction: ArrayLike,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        eta: ArrayLike,
        nodes_m: Array,
    ) -> None:
        """`clearance_m`, `friction`, `eta` (n - 1,); eta in {-1, 0, 1}, 0 without friction; theta_b, l_b (n,)."""
        bases, angles = np.asarray(l_b, dtype=float), np.asarray(theta_b, dtype=float)
        self.nodes_m = nodes_m
        self.rods = [rod_of(tubes[i], i == 0, angles[i], bases[i], nodes_m) for i in range(len(tubes))]
        count = np.cumsum([0] + [len(rod.ds) for rod in self.rods])
        self.elements = [slice(a, b) for a, b in zip(count[:-1], count[1:], strict=True)]
        self.points = [slice(a + i, b + i + 1) for i, (a, b) in enumerate(zip(count[:-1], count[1:], strict=True))]
        self.u_hat = np.concatenate([rod.u_hat for rod in self.rods])
        ds = np.concatenate([rod.ds for rod in self.rods])[:, None]
        free = np.ones((count[-1], 3), dtype=bool)
        free[:, :2] = ~np.concatenate([rod.held for rod in self.rods])[:, None]
        self.free = free.ravel()
        self.K = (np.concatenate([rod.stiffness for rod in self.rods]) * ds).ravel()  # diagonal of (10) [N m^3]
        self.compliance = np.where(self.free, 1 / self.K, 0.0)  # held components yield to nothing
        pairs = np.broadcast_arrays(clearance_m, friction, eta, np.zeros(len(tubes) - 1))[:3]
        self.contacts = self._contacts(tubes, *(np.asarray(row, dtype=float) for row in pairs))

    def _contacts(self, tubes: Sequence[Tube], clearance: Array, friction: Array, eta: Array) -> Contacts:
        rows = []
        for i in range(len(tubes) - 1):
            outer, inner = self.rods[i], self.rods[i + 1]
            scale = _force_scale(tubes[i], tubes[i + 1], clearance[i])
            radii = tubes[i].inner_diameter_m / 2, tubes[i + 1].outer_diameter_m / 2
            for j in range(max(outer.first, inner.first), min(outer.last, inner.last) + 1):
                places = self.points[i].start + j - outer.first, self.points[i + 1].start + j - inner.first
                rows.append((i, j, *places, clearance[i], eta[i] * friction[i], *radii, scale))
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        return Contacts(*columns)

    def forward(self, u: Array) -> tuple[Array, Array]:
        """(8): frames (E + n, 3, 3), points (E + n, 3) of all nodes of all tubes."""
        pairs = [rod.forward(u[e]) for rod, e in zip(self.rods, self.elements, strict=True)]
        return np.concatenate([R for R, _ in pairs]), np.concatenate([p for _, p in pairs])

    def energy(self, u: Array) -> float:
        """(10) [J]."""
        v = (u - self.u_hat).ravel()
        return float(v @ (self.K * v)) / 2

    def jacobians(self, u: Array, R: Array, p: Array) -> tuple[Array, Array]:
        """(59), (69)-(72): J_p (3 (E + n), 3 E) in the world frame, J_omega likewise in body frames."""
        J_p = np.zeros((3 * len(p), 3 * len(u)))
        J_omega = np.zeros_like(J_p)
        for rod, elements, points in zip(self.rods, self.elements, self.points, strict=True):
            rows, columns = slice(3 * points.start, 3 * points.stop), slice(3 * elements.start, 3 * elements.stop)
            J_p[rows, columns], J_omega[rows, columns] = jacobians(rod, u[elements], R[points], p[points])
        J_p[:, ~self.free] = 0.0
        J_omega[:, ~self.free] = 0.0
        return J_p, J_omega


def _force_scale(outer: Tube, inner: Tube, clearance: float) -> float:
    """The force that makes the couple EI kappa over the arm sqrt(6 c / kappa), on which it must cross the clearance.

    The Table I pair at 180 deg has 50 N on 6.7 mm at c = 0.05 mm, which is what this gives (Fig. 10).
    """
    kappa = max(float(np.hypot(s.curvature_x_per_m, s.curvature_y_per_m)) for t in (outer, inner) for s in t.sections)
    kappa = max(kappa, 1e-3)
    return min(outer.bending_stiffness_Nm2, inner.bending_stiffness_Nm2) * kappa / float(np.sqrt(6 * clearance / kappa))
