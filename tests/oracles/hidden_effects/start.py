"""Where a cold solve starts: the tubes on one common centreline, twisted as the precurvature grows from 0."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

from hidden_effects.rod import Rod
from hidden_effects.tube import Array

STAGES = 6
STEPS = 12
LARGEST_TURN_RAD = 0.6


def common_centreline(
    rods: Sequence[Rod], theta_b: Array, n_links: int, turn: Array | None = None
) -> tuple[list[Array], list[Array]]:
    """Nodal curvatures and angles of every rod without clearance; straight and free to twist behind the plate.

    `turn` (n,) turns the tubes in front of the plate at the start, in search of other equilibria.
    """
    angles = [np.full(rod.n_twist, angle) for rod, angle in zip(rods, theta_b.tolist(), strict=True)]
    for rod, angle, off in zip(rods, angles, (np.zeros(len(rods)) if turn is None else turn).tolist(), strict=True):
        angle[1:] += off * np.clip(np.cumsum(rod.element) / np.sum(rod.element), 0, 1)
    for stage in range(1 if turn is None else STAGES, STAGES + 1):
        for _ in range(STEPS):
            gradient, hessian = _energy_derivatives(rods, angles, stage / STAGES, n_links)
            step = -np.linalg.solve(hessian, gradient)
            step *= min(1.0, LARGEST_TURN_RAD / max(float(np.abs(step).max()), 1e-300))
            offset = 0
            for angle in angles:
                angle[1:] += step[offset : offset + len(angle) - 1]
                offset += len(angle) - 1
            if np.abs(step).max() < 1e-8:
                break
    mean = _mean_curvature(rods, angles, 1.0, n_links)
    return [_nodal(rod, mean[rod.first : rod.last]) for rod in rods], angles


def stability(rods: Sequence[Rod], angles: Sequence[Array], n_links: int) -> float:
    """Smallest eigenvalue of the second variation against int dtheta^2 ds, times L^2 / GJ of the innermost tube."""
    _, hessian = _energy_derivatives(rods, angles, 1.0, n_links)
    mass = np.zeros_like(hessian)
    start = 0
    for rod in rods:
        shape = rod.twist[:, 1:]
        own = slice(start, start + shape.shape[1])
        mass[own, own] = (shape * rod.h[:, None]).T @ shape + 1e-9 * np.eye(shape.shape[1])
        start = own.stop
    tube = rods[-1].tube
    return (
        float(eigh(hessian, mass, eigvals_only=True, subset_by_index=[0, 0])[0])
        * tube.length_m**2
        / tube.torsional_stiffness_Nm2
    )


def _turned(rod: Rod, angle: Array, scale: float) -> Array:
    at = rod.twist @ angle
    x, y = scale * rod.v[:, 0], scale * rod.v[:, 1]
    return np.column_stack([np.cos(at) * x - np.sin(at) * y, np.sin(at) * x + np.cos(at) * y])


def _mean_curvature(rods: Sequence[Rod], angles: Sequence[Array], scale: float, n_links: int) -> Array:
    total, stiffness = np.zeros((n_links, 2)), np.zeros(n_links)
    for rod, angle in zip(rods, angles, strict=True):
        own = slice(rod.first, rod.last)
        EI = rod.tube.bending_stiffness_Nm2 * (rod.middle > 0)
        total[own] += EI[:, None] * _turned(rod, angle, scale)
        stiffness[own] += EI
    return np.asarray(total / np.maximum(stiffness, 1e-30)[:, None])


def _energy_derivatives(
    rods: Sequence[Rod], angles: Sequence[Array], scale: float, n_links: int
) -> tuple[Array, Array]:
    """Derivatives of the energy at the best common curvature by all angles but those at the collars."""
    sizes = [rod.n_twist - 1 for rod in rods]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    gradient, hessian = np.zeros(starts[-1]), np.zeros((starts[-1], starts[-1]))
    mean = _mean_curvature(rods, angles, scale, n_links)
    total = np.zeros(n_links)
    spread = []  # per rod: EI J w on all links, zero where it is not
    for rod, angle in zip(rods, angles, strict=True):
        total[rod.first : rod.last] += rod.tube.bending_stiffness_Nm2
        w = _turned(rod, angle, scale)
        row = np.zeros((n_links, 2))
        row[rod.first : rod.last] = rod.tube.bending_stiffness_Nm2 * np.column_stack([-w[:, 1], w[:, 0]])
        spread.append(row)
    for i, (rod, angle) in enumerate(zip(rods, angles, strict=True)):
        own, shape = slice(rod.first, rod.last), rod.twist[:, 1:]
        h = rod.h * (rod.middle > 0)
        w = _turned(rod, angle, scale)
        at_i = slice(starts[i], starts[i + 1])
        EI = rod.tube.bending_stiffness_Nm2
        gradient[at_i] = -shape.T @ (h * np.sum(spread[i][own] * mean[own], axis=1))
        second = EI * np.sum(w * mean[own], axis=1)
        hessian[at_i, at_i] += (shape * (h * second)[:, None]).T @ shape
        for j, other in enumerate(rods):
            a, b = max(rod.first, other.first), min(rod.last, other.last)
            cut_i, cut_j = slice(a - rod.first, b - rod.first), slice(a - other.first, b - other.first)
            weight = -np.sum(spread[i][a:b] * spread[j][a:b], axis=1) / total[a:b] * h[cut_i]
            hessian[at_i, starts[j] : starts[j + 1]] += (shape[cut_i] * weight[:, None]).T @ other.twist[cut_j, 1:]
        stiff = rod.tube.torsional_stiffness_Nm2 / rod.element
        twist = np.diff(angle) * stiff
        gradient[at_i] += twist - np.append(twist[1:], 0)
        block = np.diag(stiff + np.append(stiff[1:], 0)) - np.diag(stiff[1:], 1) - np.diag(stiff[1:], -1)
        hessian[at_i, at_i] += block
    return gradient, hessian


def _nodal(rod: Rod, curvature: Array) -> Array:
    """Nodal values closest to the curvature of the links (S, 2)."""
    weighted = rod.bend * rod.h[:, None]
    normal = weighted.T @ rod.bend
    normal[np.diag_indices_from(normal)] += 1e-9 * np.trace(normal) / len(normal)
    return np.asarray(np.linalg.solve(normal, weighted.T @ curvature)).ravel()
