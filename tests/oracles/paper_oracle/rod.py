"""One tube on the mesh: where its curvatures put it, and by which derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from paper_oracle.se3 import Array, C, dexp, exp, hat, rotation_z
from paper_oracle.tubes import Tube


@dataclass(frozen=True, eq=False)
class Rod:
    """One tube on the mesh: E elements, E + 1 nodes."""

    first: int  # node of the mesh at its collar
    ds: Array  # (E,) [m]
    u_hat: Array  # (E, 3) precurvature [1/m]
    stiffness: Array  # (E, 3) k_xy, k_xy, k_z [N m^2]
    held: NDArray[np.bool_]  # (E,) on the axis, inside the plate's guide
    base_R: Array  # (3, 3)
    base_p: Array  # (3,) [m]

    @property
    def last(self) -> int:
        return self.first + len(self.ds)

    def forward(self, u: Array) -> tuple[Array, Array]:
        """(57): frames (E + 1, 3, 3) and points (E + 1, 3) [m] for curvatures u (E, 3)."""
        turn = u * self.ds[:, None]
        steps, moves = exp(turn), dexp(turn)[..., 2] * self.ds[:, None]
        R, p = np.empty((len(u) + 1, 3, 3)), np.empty((len(u) + 1, 3))
        R[0], p[0] = self.base_R, self.base_p
        for e in range(len(u)):
            p[e + 1] = p[e] + R[e] @ moves[e]
            R[e + 1] = R[e] @ steps[e]
        return R, p


def rod_of(tube: Tube, is_outermost: bool, theta: float, base: float, nodes: Array) -> Rod:
    joints = base + np.cumsum([0.0] + [section.length_m for section in tube.sections])
    first, last = (int(np.argmin(abs(nodes - s))) for s in joints[[0, -1]])
    ds, middle = np.diff(nodes[first : last + 1]), (nodes[first:last] + nodes[first + 1 : last + 1]) / 2
    section = np.clip(np.searchsorted(joints, middle) - 1, 0, len(tube.sections) - 1)
    u_hat = np.array([[s.curvature_x_per_m, s.curvature_y_per_m, 0.0] for s in tube.sections])[section]
    bending = tube.bending_stiffness_Nm2
    stiffness = np.tile([bending, bending, bending / (1 + tube.poisson_ratio)], (len(ds), 1))
    held = (middle < 0) & is_outermost
    return Rod(first, ds, u_hat, stiffness, held, rotation_z(theta), np.array([0.0, 0.0, base]))


def jacobians(rod: Rod, u: Array, R: Array, p: Array) -> tuple[Array, Array]:
    """J_p, J_omega of one tube; p, R at E + 1 nodes.

    Erratum to (62)-(63): block (j, k) is of element k, from node k to k + 1, and vanishes for j <= k.
    """
    D, E = D_E(rod, u, R)
    arm = p[:, None] - p[None, :-1]  # (node j, element k, 3)
    J_p = -hat(arm) @ D + E  # erratum: (69) has the sign of <p_j - p_k> wrong
    J_omega = R.transpose(0, 2, 1)[:, None] @ D  # (70)
    later = (np.arange(len(p))[:, None] > np.arange(len(u)))[..., None, None]
    shape = 3 * len(p), 3 * len(u)
    flat = [np.where(later, J, 0.0).transpose(0, 2, 1, 3).reshape(shape) for J in (J_p, J_omega)]
    return flat[0], flat[1]


def D_E(rod: Rod, u: Array, R: Array) -> tuple[Array, Array]:
    """(71)-(72), each (E, 3, 3); R (E + 1, 3, 3)."""
    ds = rod.ds[:, None, None]
    turn = u * rod.ds[:, None]
    return R[:-1] @ dexp(turn) * ds, R[:-1] @ C(turn) * ds**2
