"""The algorithm of Ha, Fagogenis, Dupont, IEEE T-RO 35(2), 2019, as printed: an oracle for tests, a baseline for time.

Sections II-E and III with Appendices A and B, in SI units. Equation numbers are the paper's; where its text is damaged
the equation that derivation and finite differences confirm stands here, and the line says so ("erratum"). Two ways to
the solution of the same discretised problem:

- `solve`, the documented default and the paper's own: linearise, climb the dual by projected gradient ascent with the
  Woodbury solve of Appendix A, linearise again. Nothing is added but a unit for lambda (see `Ascent`); the switch
  `momentum`, off by default, is not the paper's.
- `refine`, not the paper's: Newton on the KKT conditions of what that outer loop converges to, with exact derivatives.

Conventions. Tubes are numbered from the outermost; tube i is clamped at its collar on the axis, position (0, 0, l_ib),
frame Rz(theta_ib); u_y > 0 bends towards +x. Behind the plate (s <= 0) tube 1 lies on the axis and may twist; the other
tubes are held there by their collars and by contact alone. A mesh is one list of nodes for all tubes; the curvature of
a tube is constant between nodes. The paper's curvature at the last node of a tube moves nothing and is left out.
OPENBLAS_NUM_THREADS=1 pays: the matrices are small, and on a busy machine a second thread makes it 5-10 times slower.
Indices: element e of a tube lies between its nodes e and e + 1, both counted from its collar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
E_Z = np.array([0.0, 0.0, 1.0])


# --- what a robot must tell; ctrplan.tube.Tube does -------------------------------------------------------------------


class Section(Protocol):
    """A piece of constant precurvature."""

    @property
    def length_m(self) -> float: ...
    @property
    def curvature_x_per_m(self) -> float: ...
    @property
    def curvature_y_per_m(self) -> float: ...


class Tube(Protocol):
    """Sections from base to tip; torsional stiffness is bending stiffness / (1 + nu), below (10)."""

    @property
    def outer_diameter_m(self) -> float: ...
    @property
    def inner_diameter_m(self) -> float: ...
    @property
    def bending_stiffness_Nm2(self) -> float: ...
    @property
    def poisson_ratio(self) -> float: ...
    @property
    def sections(self) -> Sequence[Section]: ...


# --- SE(3): (2), (57), (73)-(75) --------------------------------------------------------------------------------------


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


def _exp(u: Array) -> Array:
    """exp(<u>): (..., 3) [rad] -> (..., 3, 3)."""
    return np.eye(3) + hat(u) @ dexp(u)


def rotation_z(angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# --- the discretised robot --------------------------------------------------------------------------------------------


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
        steps, moves = _exp(turn), dexp(turn)[..., 2] * self.ds[:, None]
        R, p = np.empty((len(u) + 1, 3, 3)), np.empty((len(u) + 1, 3))
        R[0], p[0] = self.base_R, self.base_p
        for e in range(len(u)):
            p[e + 1] = p[e] + R[e] @ moves[e]
            R[e + 1] = R[e] @ steps[e]
        return R, p


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


def mesh(tubes: Sequence[Tube], l_b: ArrayLike, spacing_m: float, fine_m: float = 0.0, reach_m: float = 0.0) -> Array:
    """Nodes (N,) [m] at every collar, section joint, tip and the plate, at most `spacing_m` apart.

    `fine_m`, the paper has no such thing: least spacing, kept for `reach_m` before and after tube tips and section
    joints where contact forces gather, then growing by 1.4 a node up to `spacing_m`.
    """
    bases = np.asarray(l_b, dtype=float)
    marks = {0.0}
    for tube, base in zip(tubes, bases, strict=True):
        marks |= {base + sum(s.length_m for s in tube.sections[:k]) for k in range(len(tube.sections) + 1)}
    corners = np.array(sorted(marks))
    corners = corners[np.append(True, np.diff(corners) > 1e-9)]
    nodes = [corners[:1]]
    for start, end in zip(corners[:-1], corners[1:], strict=True):
        if fine_m:
            nodes.append(start + _graded(end - start, spacing_m, fine_m, reach_m))
        else:
            nodes.append(np.linspace(start, end, int(np.ceil((end - start) / spacing_m - 1e-9)) + 1)[1:])
    return np.concatenate(nodes)


def _graded(length: float, spacing: float, fine: float, reach: float) -> Array:
    """Positions in (0, length], fine at both ends."""
    places, at = [0.0], 0.0
    while at < length / 2:
        step = fine if at < reach else min(spacing, fine * 1.4 ** (1 + (at - reach) / (3 * fine)))
        at += step
        places.append(at)
    half = np.array(places) * (length / 2) / at
    return np.concatenate([half, length - half[-2::-1]])[1:]


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
        self.rods = [_rod(tubes[i], i == 0, angles[i], bases[i], nodes_m) for i in range(len(tubes))]
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
            J_p[rows, columns], J_omega[rows, columns] = _jacobians(rod, u[elements], R[points], p[points])
        J_p[:, ~self.free] = 0.0
        J_omega[:, ~self.free] = 0.0
        return J_p, J_omega


def _rod(tube: Tube, is_outermost: bool, theta: float, base: float, nodes: Array) -> Rod:
    joints = base + np.cumsum([0.0] + [section.length_m for section in tube.sections])
    first, last = (int(np.argmin(abs(nodes - s))) for s in joints[[0, -1]])
    ds, middle = np.diff(nodes[first : last + 1]), (nodes[first:last] + nodes[first + 1 : last + 1]) / 2
    section = np.clip(np.searchsorted(joints, middle) - 1, 0, len(tube.sections) - 1)
    u_hat = np.array([[s.curvature_x_per_m, s.curvature_y_per_m, 0.0] for s in tube.sections])[section]
    bending = tube.bending_stiffness_Nm2
    stiffness = np.tile([bending, bending, bending / (1 + tube.poisson_ratio)], (len(ds), 1))
    held = (middle < 0) & is_outermost
    return Rod(first, ds, u_hat, stiffness, held, rotation_z(theta), np.array([0.0, 0.0, base]))


def _force_scale(outer: Tube, inner: Tube, clearance: float) -> float:
    """The force that makes the couple EI kappa over the arm sqrt(6 c / kappa), on which it must cross the clearance.

    The Table I pair at 180 deg has 50 N on 6.7 mm at c = 0.05 mm, which is what this gives (Fig. 10).
    """
    kappa = max(float(np.hypot(s.curvature_x_per_m, s.curvature_y_per_m)) for t in (outer, inner) for s in t.sections)
    kappa = max(kappa, 1e-3)
    return min(outer.bending_stiffness_Nm2, inner.bending_stiffness_Nm2) * kappa / float(np.sqrt(6 * clearance / kappa))


def _jacobians(rod: Rod, u: Array, R: Array, p: Array) -> tuple[Array, Array]:
    """J_p, J_omega of one tube; p, R at E + 1 nodes.

    Erratum to (62)-(63): block (j, k) is of element k, from node k to k + 1, and vanishes for j <= k.
    """
    D, E = _D_E(rod, u, R)
    arm = p[:, None] - p[None, :-1]  # (node j, element k, 3)
    J_p = -hat(arm) @ D + E  # erratum: (69) has the sign of <p_j - p_k> wrong
    J_omega = R.transpose(0, 2, 1)[:, None] @ D  # (70)
    later = (np.arange(len(p))[:, None] > np.arange(len(u)))[..., None, None]
    shape = 3 * len(p), 3 * len(u)
    flat = [np.where(later, J, 0.0).transpose(0, 2, 1, 3).reshape(shape) for J in (J_p, J_omega)]
    return flat[0], flat[1]


def _D_E(rod: Rod, u: Array, R: Array) -> tuple[Array, Array]:
    """(71)-(72), each (E, 3, 3); R (E + 1, 3, 3)."""
    ds = rod.ds[:, None, None]
    turn = u * rod.ds[:, None]
    return R[:-1] @ dexp(turn) * ds, R[:-1] @ C(turn) * ds**2


# --- step 1 of the outer loop: the zero-clearance model ---------------------------------------------------------------


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
        moment = rod.stiffness[:, :1] * _turn(middle, scale * rod.u_hat[:, :2])
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
        u[elements, :2] = _turn(-middles[i], kappa[at])
        u[elements, 2] = rate
        torque = rod.stiffness[:, 2] * rate
        stiff = rod.stiffness[:, 2] / rod.ds
        lever = -(_turn(np.pi / 2, moments[i]) * kappa[at]).sum(-1) * rod.ds  # of the energy by the middle angle
        bowl = (moments[i] * kappa[at]).sum(-1) * rod.ds
        np.add.at(gradient, k, -torque + lever / 2)
        np.add.at(gradient, k + 1, torque + lever / 2)
        for a, b, sign in ((0, 0, 1), (0, 1, -1), (1, 0, -1), (1, 1, 1)):
            np.add.at(hessian, (k + a, k + b), sign * stiff + bowl / 4)
        for j, (other, others) in enumerate(zip(rods, problem.points, strict=True)):
            low, high = max(rod.first, other.first), min(rod.last, other.last)
            e = np.arange(low, high)
            mine, theirs = (_turn(np.pi / 2, moments[t][e - rods[t].first]) for t in (i, j))
            couple = -(mine * theirs).sum(-1) / total[e] * np.diff(problem.nodes_m)[e] * front[e]
            row, column = points.start + e - rod.first, others.start + e - other.first
            for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
                np.add.at(hessian, (row + a, column + b), couple / 4)
    return gradient, hessian, u


def _turn(angle: ArrayLike, v: Array) -> Array:
    """Vectors (..., 2) turned by angles (...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)


# --- the paper's algorithm --------------------------------------------------------------------------------------------


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


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a solver ended."""

    u: Array  # (E, 3) [1/m]
    frames: Array  # (E + n, 3, 3)
    points: Array  # (E + n, 3) [m]
    multiplier: Array  # (M,) lambda [N/m]
    converged: bool  # all loops, by their own criteria
    outer: int  # linearisations, or Newton steps
    inner: int  # iterations of the ascent, all together
    step: float  # last |Delta u| [1/m]; nan from Newton

    @property
    def tip_m(self) -> Array:
        tip: Array = self.points[-1]
        return tip


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


# --- not the paper's: Newton on the same equations --------------------------------------------------------------------


class _Loads(NamedTuple):
    """Contact loads on the nodes at given u, lambda: what (37) has on its right-hand side."""

    force: Array  # (E + n, 3) f [N], world
    moment: Array  # (E + n, 3) [N m], world: R tau
    gap: Array  # (M, 3) P S p
    arm: Array  # (M, 3) S p
    tangent: Array  # (M, 3)


def _loads(problem: Problem, R: Array, p: Array, multiplier: Array) -> _Loads:
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
    return _Loads(force, moment, gap, arm, tangent)


def residual(problem: Problem, u: Array, multiplier: Array) -> Array:
    """(37): K (u - u_hat) - J_p^T f - J_omega^T tau, (3 E,) [N m^2], zero where the plate's guide takes the load."""
    R, p = problem.forward(u)
    J_p, J_omega = problem.jacobians(u, R, p)
    loads = _loads(problem, R, p, multiplier)
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
    gap = _loads(problem, R, p, np.zeros(len(problem.contacts.node))).gap
    beyond: Array = np.linalg.norm(gap, axis=1) - problem.contacts.clearance
    return beyond


def stiffness_matrix(problem: Problem, u: Array, multiplier: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Residual r (3 E,), its derivatives by u (3 E, 3 E) and lambda (3 E, M), G (M,), its derivative (M, 3 E)."""
    at, (R, p) = problem.contacts, problem.forward(u)
    J_p, J_omega = problem.jacobians(u, R, p)
    points, size = len(p), 3 * len(u)
    J_theta = (R @ J_omega.reshape(points, 3, size)).reshape(points, 3, size)  # rotation of a node in the world frame
    loads = _loads(problem, R, p, multiplier)
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


def _geometric(problem: Problem, u: Array, R: Array, p: Array, loads: _Loads) -> Array:
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
    D, E = _D_E(rod, u, R)
    count = len(u)
    F, W = _beyond(p, force, moment)
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
        bend = _turn(angle, change[e, :2]) + turn[:, None] * _turn(angle + np.pi / 2, u[e, :2]) + _turn(angle, u[e, :2])
        result[e, :2] = np.where(rod.held[:, None], 0.0, _turn(-angle - turn, bend))
    return result


def _beyond(p: Array, force: Array, moment: Array) -> tuple[Array, Array]:
    """F = sum f_j and W = sum (p_j - p_k) x f_j + m_j over the nodes j > k of a tube, (E, 3) each."""
    F, W = (np.cumsum(x[::-1], axis=0)[::-1][1:] for x in (force, np.cross(p, force) + moment))
    return F, W - np.cross(p[:-1], F)


def _conditions(problem: Problem, u: Array, lam: Array, unit: Array, smoothing: float, scale: Array) -> Array:
    """(37) and complementarity, scaled; J_p^T f + J_omega^T tau summed from the tip, without the matrices."""
    R, p = problem.forward(u)
    loads = _loads(problem, R, p, lam)
    r = (problem.K * (u - problem.u_hat).ravel()).reshape(-1, 3)
    for rod, e, at in zip(problem.rods, problem.elements, problem.points, strict=True):
        D, E = _D_E(rod, u[e], R[at])
        F, W = _beyond(p[at], loads.force[at], loads.moment[at])
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
    """The same problem with `share` of its friction."""
    copy = object.__new__(Problem)
    copy.__dict__.update(problem.__dict__)
    copy.contacts = replace(problem.contacts, eta_mu=share * problem.contacts.eta_mu)
    return copy
