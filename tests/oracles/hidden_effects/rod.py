"""One tube as a chain of rigid links with exact rotations between them, in curvature coordinates.

Unknowns: the curvature vector kappa (t' = kappa, components in the twist-free frame) at nodes, linear in between, free
to jump where sections meet, and the material angle theta at nodes, linear in between. The centreline follows from kappa
alone, by rotation exponentials; theta enters the elastic energy and the torques.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from hidden_effects.mesh import SAME_PLACE_M
from hidden_effects.tube import Array, Tube

BEND = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])  # curvature vector -> rotation vector e3 x kappa


def skew(a: Array) -> Array:
    """(..., 3) -> (..., 3, 3) with skew(a) b = a x b."""
    out = np.zeros((*a.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    return out - np.swapaxes(out, -1, -2)


def rotations(x: Array) -> tuple[Array, Array]:
    """Exponentials (S, 3, 3) of rotation vectors x (S, 3) and their left Jacobians."""
    angle = np.maximum(np.linalg.norm(x, axis=1), 1e-6)[:, None, None]
    X = skew(x)
    XX = X @ X
    a, b = np.sin(angle) / angle, 2 * (np.sin(angle / 2) / angle) ** 2
    c = np.where(angle < 1e-2, 1 / 6 - angle**2 / 120, (angle - np.sin(angle)) / angle**3)
    return np.eye(3) + a * X + b * XX, np.eye(3) + b * X + c * XX


def products(E: Array) -> Array:
    """E_0, E_0 E_1, ... (S, 3, 3) by doubling."""
    P, step = E.copy(), 1
    while step < len(P):
        P[step:] = P[:-step] @ P[step:]
        step *= 2
    return P


def hats(nodes: Array, x: Array) -> Array:
    """Linear shape functions of sorted nodes (N,) at x (S,): (S, N)."""
    right = np.clip(np.searchsorted(nodes, x), 1, len(nodes) - 1)
    share = np.clip((x - nodes[right - 1]) / (nodes[right] - nodes[right - 1]), 0, 1)
    table = np.zeros((len(x), len(nodes)))
    rows = np.arange(len(x))
    table[rows, right - 1] = 1 - share
    table[rows, right] = share
    return table


@dataclass(frozen=True)
class Curve:
    """Centreline at the tube's stations (K, ...) and how it moves with kappa (2 N unknowns, flat)."""

    p: Array  # (K, 3)
    Q: Array  # (K, 3, 3) twist-free frames
    joint: Array  # (S, 3) where links meet
    turn: Array  # (S, 3, 2N) rotation at the joints
    turned: Array  # (K, 3, 2N) rotation of the frames
    moved: Array  # (K, 3, 2N) displacement


class Rod:
    """The mesh and the shape functions of one tube in one configuration."""

    def __init__(self, tube: Tube, l_b: float, s: Array, links_per_node: int) -> None:
        """`s` (K,) all stations; the rod owns those from its collar `l_b` to its tip."""
        self.tube, self.l_b = tube, l_b
        own = np.flatnonzero((s >= l_b - SAME_PLACE_M) & (s <= l_b + tube.length_m + SAME_PLACE_M))
        self.first, self.last = int(own[0]), int(own[-1])
        self.s = s[own]
        self.h = np.diff(self.s)
        self.middle = (self.s[1:] + self.s[:-1]) / 2
        self._shape_functions(links_per_node)
        self.v = tube.precurvature(self.middle - l_b)

    def _shape_functions(self, links_per_node: int) -> None:
        joints = np.unique([np.argmin(np.abs(self.s - self.l_b - x)) for x in self.tube.joints_m])
        blocks, nodes = [], [self.s[:1]]
        for a, b in zip(joints[:-1], joints[1:], strict=True):
            own = self.s[np.unique(np.r_[np.arange(a, b, links_per_node), b])]
            blocks.append(hats(own, self.middle) * ((self.middle > own[0]) & (self.middle < own[-1]))[:, None])
            nodes.append(own[1:])
        self.bend = np.concatenate(blocks, axis=1)  # (S, N)
        angle_nodes = np.concatenate(nodes)
        self.twist, self.twist_at = hats(angle_nodes, self.middle), hats(angle_nodes, self.s)
        self.element = np.diff(angle_nodes)
        self.guided = np.zeros(len(self.h), dtype=bool)

    def of(self, tube: Tube) -> Rod:
        """This mesh for another tube with sections of equal lengths."""
        other = copy(self)
        other.tube, other.v = tube, tube.precurvature(self.middle - self.l_b)
        return other

    def guide(self) -> None:
        """The outermost tube lies on the axis behind the front plate, s = 0."""
        self.guided = self.middle < 0
        self.bend = self.bend * ~self.guided[:, None]

    @property
    def n_bend(self) -> int:
        return 2 * self.bend.shape[1]

    @property
    def n_twist(self) -> int:
        return self.twist.shape[1]

    def curve(self, kappa: Array) -> Curve:
        """The centreline of nodal curvatures kappa (2N,)."""
        E, left = rotations((self.bend @ kappa.reshape(-1, 2)) @ BEND.T * self.h[:, None])
        Q = np.concatenate([np.eye(3)[None], products(E)])
        half = Q[:, :, 2]
        p = np.array([0, 0, self.l_b]) + np.concatenate(
            [np.zeros((1, 3)), np.cumsum((half[1:] + half[:-1]) * self.h[:, None] / 2, axis=0)]
        )
        joint = p[:-1] + half[:-1] * self.h[:, None] / 2
        per_link = self.h[:, None, None] * (Q[:-1] @ (left @ BEND))  # (S, 3, 2)
        turn = (per_link[:, :, None, :] * self.bend[:, None, :, None]).reshape(len(self.h), 3, -1)
        turned = np.concatenate([np.zeros((1, *turn.shape[1:])), np.cumsum(turn, axis=0)])
        lever = np.concatenate([np.zeros((1, *turn.shape[1:])), np.cumsum(skew(joint) @ turn, axis=0)])
        return Curve(p, Q, joint, turn, turned, lever - skew(p) @ turned)

    def geometric_stiffness(self, curve: Curve, force: Array) -> Array:
        """Second derivative (2N, 2N) of -sum of force (K, 3) times position: loads that turn with the rod's levers."""
        behind = np.cumsum((curve.p[:, :, None] * force[:, None, :])[::-1], axis=0)[::-1][1:]
        total = np.cumsum(force[::-1], axis=0)[::-1][1:]
        G = behind - curve.joint[:, :, None] * total[:, None, :]
        G = G - np.trace(G, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        carried = (curve.turned[:-1] + curve.turn / 2).reshape(-1, self.n_bend)
        half = carried.T @ (G @ curve.turn).reshape(-1, self.n_bend)
        return -(half + half.T)

    def energy(self, kappa: Array, theta: Array) -> float:
        """Elastic energy [J]."""
        k, angle = self.bend @ kappa.reshape(-1, 2), self.twist @ theta
        cos, sin = np.cos(angle), np.sin(angle)
        own = np.column_stack([cos * k[:, 0] + sin * k[:, 1], cos * k[:, 1] - sin * k[:, 0]])
        bending = (self.h * ~self.guided) @ self.tube.energy_density(own - self.v)
        return float(bending + self.tube.torsional_stiffness_Nm2 / 2 * np.sum(np.diff(theta) ** 2 / self.element))

    def elastic(self, kappa: Array, theta: Array) -> tuple[Array, Array]:
        """Gradient (2N + N',) and Hessian of the elastic energy."""
        k, angle = self.bend @ kappa.reshape(-1, 2), self.twist @ theta
        cos, sin = np.cos(angle), np.sin(angle)
        back = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)  # R(-theta)
        own = np.einsum("sij,sj->si", back, k)
        turned = np.column_stack([own[:, 1], -own[:, 0]])  # d own / d theta
        m, C = self.tube.moment(own - self.v)
        h = self.h * ~self.guided
        n = self.n_bend
        gradient = np.concatenate(
            [
                (self.bend.T @ (h[:, None] * np.einsum("sji,sj->si", back, m))).ravel(),
                self.twist.T @ (h * np.sum(m * turned, axis=1)),
            ]
        )
        Ct = np.einsum("sij,sj->si", C, turned)
        mixed = np.einsum("sji,sj->si", back, Ct - np.column_stack([m[:, 1], -m[:, 0]]))
        kk = np.einsum("ski,skl,slj->sij", back, C, back)
        tt = np.sum(turned * Ct, axis=1) - np.sum(m * own, axis=1)
        H = np.zeros((n + self.n_twist,) * 2)
        weighted = self.bend * h[:, None]
        for i in range(2):
            for j in range(2):
                H[i:n:2, j:n:2] = weighted.T @ (kk[:, i, j, None] * self.bend)
            H[i:n:2, n:] = weighted.T @ (mixed[:, i, None] * self.twist)
        H[n:, :n] = H[:n, n:].T
        H[n:, n:] = (self.twist * h[:, None]).T @ (tt[:, None] * self.twist)
        stiff = self.tube.torsional_stiffness_Nm2 / self.element
        at = np.arange(len(stiff))
        for a, b, sign in ((0, 0, 1), (1, 1, 1), (0, 1, -1), (1, 0, -1)):
            H[n + at + a, n + at + b] += sign * stiff
        twist = np.diff(theta) * stiff
        gradient[n + 1 :] += twist
        gradient[n:-1] -= twist
        return gradient, H
