"""The paper's algorithm: Section II-E, and Section III for friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from paper_oracle.problem import Problem
from paper_oracle.se3 import Array, hat
from paper_oracle.solution import Solution
from paper_oracle.zero_clearance_model import zero_clearance


@dataclass(frozen=True)
class Ascent:
    """The loops of Section II-E.

    delta = 1e-3 "depends on the units", which the paper does not give. Here lambda_k is measured in f_ref / c, f_ref
    being the force expected of the pair (`_force_scale`), and G_k in c^2: the update is
    lambda_k += delta (f_ref / c) G_k / c^2, and `start` is in f_ref / c. In these units delta = 1e-3 converges for the
    robots of Tables I and II, with hundreds to thousands of inner iterations as the paper says; 1e-2 oscillates.
    """

    delta: float = 1e-3
    start: float = 1.0  # of every lambda_k, "such as 1"
    alpha: float = 1.0  # share of a step that the outer loop takes
    gamma: float = 1e-3  # |Delta u| [1/m] that ends the outer loop: the paper's 1e-6 in 1/mm
    tolerance: float = 1e-7  # change of lambda_k in f_ref / c between two iterations: end of the inner loop
    max_inner: int = 5000
    max_outer: int = 30
    momentum: bool = False  # NOT the paper's: Nesterov's extrapolation, restarted when the step turns round


class Linear(NamedTuple):
    """Section II-E, initialisation 1)-4), and Section III; about u*. X, Y stack three rows a contact, (51)-(52)."""

    X: Array  # (3 M, 3 E)
    Y: Array  # (3 M, 3 E)
    x: Array  # (M, 3)
    q: Array  # (M,)
    g: Array  # (3 E,)
    torque: Array  # (3 E, M) columns J_omega^T tau / lambda_k of (42)
    KY: Array  # (3 E, 3 M) K^-1 Y^T
    XKY: Array  # (3 M, 3 M) X K^-1 Y^T


def linearise(problem: Problem, u: Array) -> Linear:
    at, (R, p) = problem.contacts, problem.forward(u)
    J_p, J_omega = problem.jacobians(u, R, p)
    tangent = R[at.outer, :, 2]
    P = np.eye(3) - tangent[:, :, None] * tangent[:, None, :]  # (22)
    blocks = J_p.reshape(len(p), 3, -1)
    SJ = blocks[at.outer] - blocks[at.inner]
    x = (P @ (p[at.outer] - p[at.inner])[..., None])[..., 0]  # (25)
    X = P @ SJ
    Y = P @ (np.eye(3) - at.eta_mu[:, None, None] * hat(tangent)) @ SJ  # erratum: (47) lacks eta_k
    about_z = J_omega.reshape(len(p), 3, -1)[:, 2]
    share = (at.clearance * at.eta_mu)[:, None]
    torque = (share * (at.r_in[:, None] * about_z[at.outer] - at.r_out[:, None] * about_z[at.inner])).T  # (41)-(43)
    X, Y = X.reshape(-1, X.shape[-1]), Y.reshape(-1, X.shape[-1])
    KY = problem.compliance[:, None] * Y.T
    q = ((x * x).sum(-1) - at.clearance**2) / 2
    g = problem.K * (u - problem.u_hat).ravel()  # erratum: (13) is K (u* - u_hat)
    return Linear(X, Y, x, q, g, torque, KY, X @ KY)


def minimiser(problem: Problem, linear: Linear, multiplier: Array) -> Array:
    """Delta u = -Q^-1 h (erratum to (31)-(32)), by Appendix A, (54)-(56), over the m contacts that press."""
    k = np.flatnonzero(multiplier > 0)
    rows = (3 * k[:, None] + np.arange(3)).ravel()
    h = linear.g - linear.torque[:, k] @ multiplier[k] + linear.Y[rows].T @ (multiplier[k, None] * linear.x[k]).ravel()
    Kh = problem.compliance * h
    A = linear.XKY[np.ix_(rows, rows)]
    A[np.diag_indices_from(A)] += np.repeat(1 / multiplier[k], 3)
    v = np.linalg.solve(A, linear.X[rows] @ Kh) if len(k) else np.zeros(0)
    step: Array = linear.KY[:, rows] @ v - Kh
    return step


def constraint(linear: Linear, step: Array) -> Array:
    """G_k (24), the gradient of the dual (30); (M,) [m^2]."""
    y = (linear.X @ step).reshape(-1, 3)
    G: Array = (y * y).sum(-1) / 2 + (linear.x * y).sum(-1) + linear.q
    return G


def inner_loop(problem: Problem, linear: Linear, start: Array, ascent: Ascent) -> tuple[Array, Array, int, bool]:
    """Section II-E, steps 1)-7): Delta u (3 E,), lambda (M,), iterations, converged."""
    at = problem.contacts
    unit = at.force_scale / at.clearance
    rate = ascent.delta * unit / at.clearance**2
    multiplier, ahead, age = start, start, 0
    for iteration in range(1, ascent.max_inner + 1):
        step = minimiser(problem, linear, ahead)
        updated = np.maximum(ahead + rate * constraint(linear, step), 0.0)
        change = updated - multiplier
        if ascent.momentum:
            age = 0 if (ahead - updated) @ (change / rate) > 0 else age + 1
            ahead = np.maximum(updated + age / (age + 3) * change, 0.0)
        else:
            ahead = updated
        multiplier = updated
        if np.abs(change / unit).max() < ascent.tolerance:
            return minimiser(problem, linear, multiplier), multiplier, iteration, True
    return minimiser(problem, linear, multiplier), multiplier, ascent.max_inner, False


DEFAULT_ASCENT = Ascent()


def solve(
    problem: Problem, ascent: Ascent = DEFAULT_ASCENT, u: Array | None = None, multiplier: Array | None = None
) -> Solution:
    """The outer loop of Section II-E, from the zero-clearance model unless given a start; eta selects Section III."""
    at = problem.contacts
    u = zero_clearance(problem) if u is None else u
    multiplier = ascent.start * at.force_scale / at.clearance if multiplier is None else multiplier
    outer, inner, size, done = 0, 0, np.inf, False
    while outer < ascent.max_outer and size >= ascent.gamma:
        step, multiplier, iterations, done = inner_loop(problem, linearise(problem, u), multiplier, ascent)
        u = u + ascent.alpha * step.reshape(-1, 3)
        outer, inner, size = outer + 1, inner + iterations, float(np.linalg.norm(step))
    return Solution(u, *problem.forward(u), multiplier, done and size < ascent.gamma, outer, inner, size)
