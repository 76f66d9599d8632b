"""Equations (37) at given curvatures and multipliers, and their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from paper_oracle.problem import Problem
from paper_oracle.rod import D_E, Rod
from paper_oracle.se3 import Array, C, dexp, hat


class Loads(NamedTuple):
    """Contact loads on the nodes at given u, lambda: what (37) has on its right-hand side."""

    force: Array  # (E + n, 3) f [N], world
    moment: Array  # (E + n, 3) [N m], world: R tau
    gap: Array  # (M, 3) P S p
    arm: Array  # (M, 3) S p
    tangent: Array  # (M, 3)


def loads_on_nodes(problem: Problem, R: Array, p: Array, multiplier: Array) -> Loads:
    """(36), (38), (40)-(42)."""
    at = problem.contacts
    tangent, arm = R[at.outer, :, 2], p[at.outer] - p[at.inner]
    gap = arm - tangent * (tangent * arm).sum(-1, keepdims=True)
    on_outer = -multiplier[:, None] * (gap + at.eta_mu[:, None] * np.cross(tangent, gap))
    torque = (multiplier * at.eta_mu * (gap * gap).sum(-1) / at.clearance)[
        :, None
    ]  # (41): c lambda, |gap| = c in contact
    force, moment = np.zeros_like(p), np.zeros_like(p)
    np.add.at(force, at.outer, on_outer)
    np.add.at(force, at.inner, -on_outer)
    np.add.at(moment, at.outer, torque * at.r_in[:, None] * tangent)
    np.add.at(moment, at.inner, -torque * at.r_out[:, None] * R[at.inner, :, 2])
    return Loads(force, moment, gap, arm, tangent)


def residual(problem: Problem, u: Array, multiplier: Array) -> Array:
    """(37): K (u - u_hat) - J_p^T f - J_omega^T tau, (3 E,) [N m^2], zero where the plate's guide takes the load."""
    R, p = problem.forward(u)
    J_p, J_omega = problem.jacobians(u, R, p)
    loads = loads_on_nodes(problem, R, p, multiplier)
    body = np.einsum("jab,ja->jb", R, loads.moment)
    r: Array = problem.K * (u - problem.u_hat).ravel() - J_p.T @ loads.force.ravel() - J_omega.T @ body.ravel()
    return np.where(problem.free, r, 0.0)


def imbalance(problem: Problem, u: Array, multiplier: Array) -> float:
    """Largest moment that (37) leaves, over the robot's own, EI * precurvature."""
    ds = np.concatenate([rod.ds for rod in problem.rods])[:, None]
    own = max(float(np.abs(rod.stiffness[:, :1] * rod.u_hat).max()) for rod in problem.rods)
    return float(np.abs(residual(problem, u, multiplier).reshape(-1, 3) / ds).max()) / own


def gaps(problem: Problem, u: Array) -> Array:
    """|P S p| - c, (M,) [m]; (14) demands <= 0."""
    R, p = problem.forward(u)
    gap = loads_on_nodes(problem, R, p, np.zeros(len(problem.contacts.node))).gap
    beyond: Array = np.linalg.norm(gap, axis=1) - problem.contacts.clearance
    return beyond


def stiffness_matrix(problem: Problem, u: Array, multiplier: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Residual r (3 E,), its derivatives by u (3 E, 3 E) and lambda (3 E, M), G (M,), its derivative (M, 3 E)."""
    at, (R, p) = problem.contacts, problem.forward(u)
    J_p, J_omega = problem.jacobians(u, R, p)
    points, size = len(p), 3 * len(u)
    J_theta = (R @ J_omega.reshape(points, 3, size)).reshape(points, 3, size)  # rotation of a node in the world frame
    loads = loads_on_nodes(problem, R, p, multiplier)
    t, gap, arm = loads.tangent, loads.gap, loads.arm
    r = problem.K * (u - problem.u_hat).ravel() - J_p.T @ loads.force.ravel()
    r -= J_theta.reshape(-1, size).T @ loads.moment.ravel()

    blocks = J_p.reshape(points, 3, size)
    d_arm = blocks[at.outer] - blocks[at.inner]
    d_t, d_t_inner = (-hat(R[rows, :, 2]) @ J_theta[rows] for rows in (at.outer, at.inner))
    along = (t * arm).sum(-1)
    d_along = np.einsum("ka,kaz->kz", t, d_arm) + np.einsum("ka,kaz->kz", arm, d_t)
    d_gap = d_arm - t[:, :, None] * d_along[:, None] - along[:, None, None] * d_t
    em, lam = at.eta_mu[:, None, None], multiplier[:, None, None]
    d_force = -lam * (d_gap + em * (hat(t) @ d_gap - hat(gap) @ d_t))
    per_lambda = -(gap + at.eta_mu[:, None] * np.cross(t, gap))
    torque = at.eta_mu * (gap * gap).sum(-1) / at.clearance
    d_torque = 2 * (multiplier * at.eta_mu / at.clearance)[:, None] * np.einsum("ka,kaz->kz", gap, d_gap)

    H = np.diag(problem.K) - _geometric(problem, u, R, p, loads)
    H -= d_arm.reshape(-1, size).T @ d_force.reshape(-1, size)
    H_lambda = -np.einsum("kaz,ka->zk", d_arm, per_lambda)
    for rows, radius, turning in ((at.outer, at.r_in, d_t), (at.inner, -at.r_out, d_t_inner)):
        axis, turns = R[rows, :, 2], J_theta[rows]
        d_moment = (multiplier * torque)[:, None, None] * turning + axis[:, :, None] * d_torque[:, None]
        H -= turns.reshape(-1, size).T @ (radius[:, None, None] * d_moment).reshape(-1, size)
        H_lambda -= np.einsum("kaz,ka->zk", turns, (radius * torque)[:, None] * axis)
    G = ((gap * gap).sum(-1) - at.clearance**2) / 2
    return r, H, H_lambda, G, np.einsum("ka,kaz->kz", gap, d_gap)


def _geometric(problem: Problem, u: Array, R: Array, p: Array, loads: Loads) -> Array:
    """Derivative by u (3 E, 3 E) of J_p^T f + J_omega^T tau, the loads on the nodes being fixed in the world."""
    total = np.zeros((3 * len(u), 3 * len(u)))
    for rod, elements, points in zip(problem.rods, problem.elements, problem.points, strict=True):
        block = slice(3 * elements.start, 3 * elements.stop)
        total[block, block] = _geometric_of(
            rod, u[elements], R[points], p[points], loads.force[points], loads.moment[points]
        )
    total[~problem.free] = 0.0
    total[:, ~problem.free] = 0.0
    return total


def _geometric_of(rod: Rod, u: Array, R: Array, p: Array, force: Array, moment: Array) -> Array:
    """One tube's part. Beyond node k act F = sum f_j, W = sum (p_j - p_k) x f_j + m_j, and S = sum <f_j><p_j - p_k>."""
    D, E = D_E(rod, u, R)
    count = len(u)
    F, W = beyond_nodes(p, force, moment)
    lever = p[None] - p[:-1, None]  # (element k, node j, 3)
    beyond = (np.arange(count + 1) > np.arange(count)[:, None])[..., None]
    S = np.where(beyond[..., None], hat(force)[None] @ hat(lever), 0.0).sum(1)
    DT, ET = D.transpose(0, 2, 1), E.transpose(0, 2, 1)
    below = np.einsum("kab,lbc->kalc", DT @ (S + hat(W)) + ET @ hat(F), D)  # element l before k
    above = np.einsum("kab,lbc->kalc", DT, S @ D - hat(F) @ E)  # element l after k, or k itself
    earlier = np.tri(count, k=-1, dtype=bool)[:, None, :, None]
    blocks: Array = np.where(earlier, below, above)
    k = np.arange(count)
    blocks[k, :, k] += _bending_of_dexp(rod, u, np.einsum("kba,kb->ka", R[:-1], W), np.einsum("kba,kb->ka", R[:-1], F))
    matrix: Array = blocks.reshape(3 * count, 3 * count)
    return matrix


def _bending_of_dexp(rod: Rod, u: Array, b: Array, a: Array) -> Array:
    """d/du (dexp(u ds)^T b ds + C(u ds)^T a ds^2), (E, 3, 3), by complex steps: exact to rounding."""
    ds = rod.ds[:, None]
    columns = []
    for axis in range(3):
        turn = (u * ds).astype(complex)
        turn[:, axis] += 1e-30j * rod.ds
        value = np.einsum("kba,kb->ka", dexp(turn), b) * ds + np.einsum("kba,kb->ka", C(turn), a) * ds**2
        columns.append(value.imag / 1e-30)
    return np.stack(columns, axis=-1)


def beyond_nodes(p: Array, force: Array, moment: Array) -> tuple[Array, Array]:
    """F = sum f_j and W = sum (p_j - p_k) x f_j + m_j over the nodes j > k of a tube, (E, 3) each."""
    F, W = (np.cumsum(x[::-1], axis=0)[::-1][1:] for x in (force, np.cross(p, force) + moment))
    return F, W - np.cross(p[:-1], F)
