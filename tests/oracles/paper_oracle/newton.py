"""Not the paper's: Newton's method on the same equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from paper_oracle.equilibrium import beyond_nodes, loads_on_nodes, stiffness_matrix
from paper_oracle.problem import Problem
from paper_oracle.rod import D_E
from paper_oracle.se3 import Array
from paper_oracle.solution import Solution
from paper_oracle.zero_clearance_model import turned, zero_clearance


def refine(
    problem: Problem, start: Solution | None = None, *, tolerance: float = 1e-9, max_steps: int = 400
) -> Solution:
    """KKT conditions of the discretised problem by semismooth Newton: (37) and 0 <= lambda, G <= 0, lambda G = 0.

    Complementarity is Fischer and Burmeister's a + b = sqrt(a^2 + b^2 + 2 eps), a = lambda c / f_ref, b = -G / c^2.
    Friction is turned on at the first eps, which then falls to 1e-15; a stage that Newton does not reach is halved.
    Geometry, normals and Jacobians are those of the current u in every step, so that nothing is left to relinearise.
    Starts from the zero-clearance model, or where another solution ended. `converged` demands `tolerance` of (37) in
    units of the root of twice the energy that straightens the tubes, and of the complementarity.
    """
    unit = problem.contacts.force_scale / problem.contacts.clearance
    u = zero_clearance(problem) if start is None else start.u
    state = u, 0.1 * unit if start is None else np.maximum(start.multiplier, 1e-3 * unit)
    stages = [(0.0 if start is None else 1.0, 1e-2)]
    stages += [(1.0, 1e-2)] * (start is None and bool(problem.contacts.eta_mu.any()))
    stages += [(1.0, 10.0**-k) for k in (3, 4, 6, 8, 11, 15)]
    steps, stages = 0, stages[::-1]
    done = stages.pop()
    state, _, steps = _stage(problem, state, *done, 1e-4, 60)
    while stages and steps < max_steps:
        target = stages[-1]
        enough = tolerance if len(stages) == 1 else min(1e-4, 0.1 * float(np.sqrt(target[1])))
        reached, good, used = _stage(problem, state, *target, enough, 15)
        steps += used
        if good:
            state, done = reached, stages.pop()
        else:
            stages.append(((done[0] + target[0]) / 2, float(np.sqrt(done[1] * target[1]))))
    u, multiplier = state
    return Solution(u, *problem.forward(u), multiplier, not stages, steps, 0, float("nan"))


def _stage(
    problem: Problem, state: tuple[Array, Array], friction: float, smoothing: float, tolerance: float, limit: int
) -> tuple[tuple[Array, Array], bool, int]:
    """Newton with line search at a share of friction and a fixed eps: (u, lambda), reached, steps."""
    problem = _with_friction(problem, friction)
    at, free = problem.contacts, problem.free
    unit, count = at.force_scale / at.clearance, int(problem.free.sum())
    scale = 1 / np.sqrt(problem.K[free] * 2 * problem.energy(np.zeros_like(problem.u_hat)))
    for taken in range(limit + 1):
        system, right = _newton(problem, *state, unit, smoothing, scale)
        norm = float(np.linalg.norm(right))
        if norm < tolerance or taken == limit:
            break
        step, share, before = np.linalg.solve(system, -right), 1.0, state
        while True:
            change = np.zeros(free.size)
            change[free] = share * step[:count]
            state = _moved(problem, before[0], change.reshape(-1, 3)), before[1] + share * step[count:] * unit
            after = float(np.linalg.norm(_conditions(problem, *state, unit, smoothing, scale)))
            if after < (1 - 1e-4 * share) * norm:
                break
            share /= 2
            if share < 1e-3:
                return before, norm < 1e-6, taken
    return state, norm < tolerance, taken


def _moved(problem: Problem, u: Array, change: Array) -> Array:
    """u + change to first order, but adding the bending curvatures in the tubes' twist-free frames.

    Added in material frames, a twist of 0.1 rad would move the centreline by its square, several clearances. This is
    what makes Newton's method take full steps.
    """
    result = u + change
    for rod, e in zip(problem.rods, problem.elements, strict=True):
        by_z = np.stack([u[e, 2], change[e, 2]]) * rod.ds
        angle, turn = np.cumsum(by_z, axis=1) - by_z / 2  # up to the middle of each element
        bend = (
            turned(angle, change[e, :2]) + turn[:, None] * turned(angle + np.pi / 2, u[e, :2]) + turned(angle, u[e, :2])
        )
        result[e, :2] = np.where(rod.held[:, None], 0.0, turned(-angle - turn, bend))
    return result


def _conditions(problem: Problem, u: Array, lam: Array, unit: Array, smoothing: float, scale: Array) -> Array:
    """(37) and complementarity, scaled; J_p^T f + J_omega^T tau summed from the tip, without the matrices."""
    R, p = problem.forward(u)
    loads = loads_on_nodes(problem, R, p, lam)
    r = (problem.K * (u - problem.u_hat).ravel()).reshape(-1, 3)
    for rod, e, at in zip(problem.rods, problem.elements, problem.points, strict=True):
        D, E = D_E(rod, u[e], R[at])
        F, W = beyond_nodes(p[at], loads.force[at], loads.moment[at])
        r[e] -= np.einsum("kab,ka->kb", D, W) + np.einsum("kab,ka->kb", E, F)
    a, b = lam / unit, (1 - (loads.gap**2).sum(-1) / problem.contacts.clearance**2) / 2
    return np.concatenate([r.ravel()[problem.free] * scale, a + b - np.sqrt(a * a + b * b + 2 * smoothing)])


def _newton(problem: Problem, u: Array, lam: Array, unit: Array, smoothing: float, scale: Array) -> tuple[Array, Array]:
    r, H, H_lambda, G, G_u = stiffness_matrix(problem, u, lam)
    free, c2 = problem.free, problem.contacts.clearance**2
    a, b = lam / unit, -G / c2
    root = np.sqrt(a * a + b * b + 2 * smoothing)
    by_a, by_b = 1 - a / root, 1 - b / root
    system = np.block(
        [
            [scale[:, None] * H[np.ix_(free, free)], scale[:, None] * H_lambda[free] * unit],
            [-(by_b / c2)[:, None] * G_u[:, free], np.diag(by_a)],
        ]
    )
    return system, np.concatenate([r[free] * scale, a + b - root])


def _with_friction(problem: Problem, share: float) -> Problem:
    """This problem with `share` of its friction."""
    copy = object.__new__(Problem)
    copy.__dict__.update(problem.__dict__)
    copy.contacts = replace(problem.contacts, eta_mu=share * problem.contacts.eta_mu)
    return copy
