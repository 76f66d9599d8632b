"""Step 1 of the outer loop: the zero-clearance model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from paper_oracle.problem import Problem
from paper_oracle.se3 import Array


def zero_clearance(problem: Problem, scales: Sequence[float] = (0.5, 1.0)) -> Array:
    """Curvatures (E, 3) of all tubes on one common centreline, (2)-(3): the least energy over the tubes' angles.

    The centreline takes the mean curvature weighted by stiffness in front of the plate and is straight behind it.
    Newton's method on the angles at the nodes, `scales` being shares of the precurvature to pass through.
    """
    rods, count = problem.rods, len(problem.nodes_m)
    angle = np.concatenate([np.full(len(r.ds) + 1, np.arctan2(r.base_R[1, 0], r.base_R[0, 0])) for r in rods])
    fixed = np.array([points.start for points in problem.points])
    moving = np.setdiff1d(np.arange(len(angle)), fixed)
    for scale in scales:
        for _ in range(50):
            gradient, hessian, _ = _torsion(problem, angle, scale, count)
            step = np.zeros_like(angle)
            step[moving] = -np.linalg.solve(hessian[np.ix_(moving, moving)], gradient[moving])
            angle = angle + step * min(1.0, 0.5 / (abs(step).max() + 1e-300))
            if abs(step).max() < 1e-12:
                break
    return _torsion(problem, angle, 1.0, count)[2]


def _torsion(problem: Problem, angle: Array, scale: float, count: int) -> tuple[Array, Array, Array]:
    """Gradient and Hessian of the energy by the angles, and all curvatures (E, 3) in material frames."""
    rods = problem.rods
    total, bend = np.full(count - 1, 1e-30), np.zeros((count - 1, 2))
    front = (problem.nodes_m[:-1] + problem.nodes_m[1:]) / 2 > 0
    middles, moments = [], []
    for rod, points in zip(rods, problem.points, strict=True):
        at = slice(rod.first, rod.last)
        middle = (angle[points][1:] + angle[points][:-1]) / 2
        moment = rod.stiffness[:, :1] * turned(middle, scale * rod.u_hat[:, :2])
        total[at] += rod.stiffness[:, 0]
        bend[at] += moment
        middles.append(middle)
        moments.append(moment)
    kappa = np.where(front[:, None], bend / total[:, None], 0.0)
    gradient, hessian = np.zeros(len(angle)), np.zeros((len(angle), len(angle)))
    u = np.zeros_like(problem.u_hat)
    for i, (rod, points, elements) in enumerate(zip(rods, problem.points, problem.elements, strict=True)):
        at, k = slice(rod.first, rod.last), np.arange(points.start, points.stop - 1)
        rate = np.diff(angle[points]) / rod.ds
        u[elements, :2] = turned(-middles[i], kappa[at])
        u[elements, 2] = rate
        torque = rod.stiffness[:, 2] * rate
        stiff = rod.stiffness[:, 2] / rod.ds
        lever = -(turned(np.pi / 2, moments[i]) * kappa[at]).sum(-1) * rod.ds  # of the energy by the middle angle
        bowl = (moments[i] * kappa[at]).sum(-1) * rod.ds
        np.add.at(gradient, k, -torque + lever / 2)
        np.add.at(gradient, k + 1, torque + lever / 2)
        for a, b, sign in ((0, 0, 1), (0, 1, -1), (1, 0, -1), (1, 1, 1)):
            np.add.at(hessian, (k + a, k + b), sign * stiff + bowl / 4)
        for j, (other, others) in enumerate(zip(rods, problem.points, strict=True)):
            low, high = max(rod.first, other.first), min(rod.last, other.last)
            e = np.arange(low, high)
            mine, theirs = (turned(np.pi / 2, moments[t][e - rods[t].first]) for t in (i, j))
            couple = -(mine * theirs).sum(-1) / total[e] * np.diff(problem.nodes_m)[e] * front[e]
            row, column = points.start + e - rod.first, others.start + e - other.first
            for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
                np.add.at(hessian, (row + a, column + b), couple / 4)
    return gradient, hessian, u


def turned(angle: ArrayLike, v: Array) -> Array:
    """Vectors (..., 2) turned by angles (...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)
