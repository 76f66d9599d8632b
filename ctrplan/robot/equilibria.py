"""All equilibria of a robot without clearance and friction at given collars, by the torus of its tips' angles.

At their ends tubes carry no torsion. Angles there, relative to the tube around, are all that an equilibrium depends on:
from them the torsion equations (Rucker et al. 2010, eq. (3) of Ha et al. 2019 without clearance) are integrated towards
the plate, and end at relative angles R of the collars. R maps the torus of n - 1 angles at the tips to that of the
collars, wraps it around once, and depends on the translations alone. Every solution of R = alpha + 2 pi k, k
whole turns, is an equilibrium at relative collar angles alpha.

R has degree one: signs of its determinant, summed over all equilibria, make 1. Where a sum is another, one was missed.
An equilibrium is stable where the determinant of the integrated derivatives keeps its sign from the tips to the collars
(no conjugate point). Where R's determinant is positive on the whole torus there is one equilibrium at any rotation.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.mechanics.core_arrays import joint_row
from ctrplan.mechanics.tube import Loads

if TYPE_CHECKING:
    from ctrplan.mechanics.tube import Tube


class Tubes(Protocol):
    """What equilibria are enumerated of: a robot's tubes, the loads on them, and its file."""

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """Outermost first."""
        ...

    @property
    def loads(self) -> Loads:
        """Force, moment and weight."""
        ...

    @property
    def path(self) -> str | None:
        """For messages."""
        ...


STEP_M = 4e-3  # of the integration from the tips, of fourth order: angles are within 1e-6 rad of shorter ones
GRID = {1: 12, 2: 12, 3: 6, 4: 6}  # angles along each pair: none of 120 random configurations had one between them
NEWTON, FAR_RAD = 20, 0.6  # steps, and the longest of a single one
NEAR_CELLS, DENSER = 1.5, 4  # of the grid, within which the first step has to lead; else so many times as dense
ROOT_RAD, SAME_RAD = 1e-9, 1e-4  # of R, and between angles of one equilibrium
COLLAR_STEPS = 8  # of the straight part behind the plate, along which conjugate points are looked for


@shown
@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One of the shapes that a robot without clearance and friction can have."""

    tip_m: Array  # (3,) robot frame
    tip_angles_rad: Array  # (n - 1,) of each tube's end against the end of the tube around it
    twist_rad: Array  # (n - 1,) of each pair from tip to collar: half a turn and more where it is wound up
    energy_J: float  # of bending and torsion
    is_stable: bool

    def headline(self) -> str:
        """What it is, as it shows itself."""
        at = ", ".join(f"{x * 1e3:.2f}" for x in self.tip_m)
        wound = ", ".join(f"{np.degrees(x):+.0f}" for x in self.twist_rad)
        kind = "stable" if self.is_stable else "unstable"
        return f"{kind} equilibrium, tip at ({at}) mm, pairs twisted by ({wound}) deg, {self.energy_J * 1e3:.2f} mJ"


@shown
@dataclass(frozen=True, eq=False)
class Equilibria:
    """All of them at one configuration, the least energy first."""

    each: tuple[Equilibrium, ...]
    degree: int  # sum of signs, 1 unless some were missed

    @property
    def is_complete(self) -> bool:
        """Whether the signs add up."""
        return self.degree == 1

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Those in which the robot can stay."""
        return tuple(one for one in self.each if one.is_stable)

    def headline(self) -> str:
        """How many, as it shows itself."""
        missed = "" if self.is_complete else ", and some were missed"
        return f"{len(self.stable)} stable and {len(self.each) - len(self.stable)} unstable equilibria{missed}"


def equilibria(robot: Tubes, theta_b: ArrayLike, l_b: ArrayLike) -> Equilibria:
    """Every equilibrium without clearance and friction at collars (n,) [rad], (n,) [m], stable or not.

    Raises InputError for robots whose tubes carry loads, are oval or soften, and for more than five tubes.
    """
    theta, l = joint_row(theta_b, len(robot.tubes)), joint_row(l_b, len(robot.tubes))  # noqa: E741 (as in the equations)
    _refuse(robot)
    torus = Torus(robot.tubes, l)
    roots = torus.roots(np.diff(theta))
    found = [torus.equilibrium(psi, theta[0]) for psi, _ in roots]
    return Equilibria(tuple(sorted(found, key=lambda one: one.energy_J)), sum(sign for _, sign in roots))


def is_unique(robot: Tubes, l_b: ArrayLike) -> bool:
    """Whether there is one equilibrium at every rotation of the collars, at translations (n,) [m].

    False where robots are of a kind that `equilibria` refuses.
    """
    try:
        _refuse(robot)
    except InputError:
        return False
    torus = Torus(robot.tubes, joint_row(l_b, len(robot.tubes)))
    return len(robot.tubes) == 1 or bool(np.all(np.linalg.det(torus.relative(torus.shoot(torus.grid()))[1]) > 0))


def _refuse(robot: Tubes) -> None:
    rule = ""
    if robot.loads != Loads():
        rule = "has loads, with which equilibria without clearance are not enumerated"
    elif any(tube.ovality or np.isfinite(tube.softening_strain) for tube in robot.tubes):
        rule = "has oval tubes or such that soften, of which equilibria are not enumerated"
    elif len(robot.tubes) - 1 > max(GRID):
        rule = f"has {len(robot.tubes)} tubes: equilibria are enumerated of at most {max(GRID) + 1}"
    if rule:
        raise InputError(rule, file=robot.path, key="tube")


@dataclass(frozen=True)
class _Stretch:
    """A stretch along which the same tubes, the inner ones from `first` on, have smooth precurvature."""

    begin: float
    end: float
    first: int
    u: Array  # (n, 2) precurvature at its begin [1/m]
    slope: Array  # (n, 2) per m


class Torus:
    """Angles at the tips of a robot with collars at translations (n,) [m], and where they lead to."""

    def __init__(self, tubes: tuple[Tube, ...], l_b: Array) -> None:
        """Cuts the tubes in front of the plate into stretches."""
        self.l_b, self.n = l_b, len(tubes)
        self.EI = np.array([tube.bending_stiffness_Nm2 for tube in tubes])
        self.GJ = self.EI / (1 + np.array([tube.poisson_ratio for tube in tubes]))
        self.shaft = np.array([tube.shaft_compliance_rad_per_Nm for tube in tubes])
        self.stretches = tuple(_stretches(tubes, l_b))

    def grid(self, times: int = 1) -> Array:
        """(Q, n - 1) angles at the tips, evenly over the torus, so many times as dense as GRID along each."""
        count = times * GRID[self.n - 1]
        steps = np.arange(count) * 2 * np.pi / count
        return np.array(list(itertools.product(steps, repeat=self.n - 1)))

    def roots(self, alpha: Array) -> list[tuple[Array, int]]:
        """Angles at the tips and sign of every equilibrium at relative collar angles (n - 1,).

        Newton's method begins where the grid's derivatives lead into the cell around; from everywhere on a denser grid
        if the signs of what that finds do not add up.
        """
        if self.n == 1:
            return [(np.zeros(0), 1)]
        results: list[tuple[Array, int]] = []
        for times, cells in ((1, NEAR_CELLS), (DENSER, np.inf)):
            results = self._roots_from(self.grid(times), alpha, cells * 2 * np.pi / GRID[self.n - 1])
            if sum(sign for _, sign in results) == 1:
                break
        return results

    def _roots_from(self, psi: Array, alpha: Array, reach_rad: float) -> list[tuple[Array, int]]:
        results = list[tuple[Array, int]]()
        for number in range(NEWTON):
            R, by = self.relative(self.shoot(psi))
            off = np.remainder(R - alpha + np.pi, 2 * np.pi) - np.pi
            for k in np.flatnonzero(np.abs(off).max(axis=1) < ROOT_RAD):
                apart = [np.abs(np.remainder(psi[k] - x + np.pi, 2 * np.pi) - np.pi).max() for x, _ in results]
                if min(apart, default=np.inf) > SAME_RAD:
                    results.append((psi[k], int(np.sign(np.linalg.det(by[k])))))
            step = np.einsum("qij,qj->qi", np.linalg.pinv(by), off)
            most = np.abs(step).max(axis=1)
            is_open = np.abs(off).max(axis=1) >= ROOT_RAD
            if number == 0:
                is_open &= most < reach_rad
            if not is_open.any():
                break
            psi = (psi - step * np.minimum(1.0, FAR_RAD / np.maximum(most, 1e-300))[:, None])[is_open]
        return results

    def shoot(self, psi: Array, follow: list[Array] | None = None) -> Array:
        """(Q, 2, n, 1 + n) at the plate, from relative angles at the tips (Q, n - 1): angles and torsions [rad, rad/m].

        The first of the last axis are values, the others derivatives by the n angles at the tips. Determinants of the
        angles' derivatives on the way are put into `follow`.
        """
        state = np.zeros((len(psi), 2, self.n, 1 + self.n))
        state[:, 0, :, 0] = np.append(np.zeros((len(psi), 1)), np.cumsum(psi, axis=1), axis=1)
        state[:, 0, :, 1:] = np.eye(self.n)
        for part in reversed(self.stretches):
            count = max(1, int(np.ceil((part.end - part.begin) / STEP_M)))
            if np.count_nonzero(np.any(part.u[part.first :] != 0, axis=1)) < 2 and not part.slope.any():
                count = 1  # nothing to twist one another: angles are linear
            h = (part.begin - part.end) / count
            for k in range(count):
                at = part.end - part.begin + k * h
                state = self._step(part, state, at, h)
                if follow is not None:
                    follow.append(np.linalg.det(state[:, 0, :, 1:]))
        return state

    def base_angles(self, state: Array) -> Array:
        """(Q, n) angles of the collars: behind the plate tubes are straight, and twist alike all along."""
        return np.asarray(state[:, 0, :, 0] + self._behind * state[:, 1, :, 0])

    def relative(self, state: Array) -> tuple[Array, Array]:
        """(Q, n - 1) relative angles R of the collars, and (Q, n - 1, n - 1) derivatives by those of the tips."""
        by = state[:, 0, :, 1:] + self._behind[:, None] * state[:, 1, :, 1:]
        of_pairs = np.cumsum(by[:, :, ::-1], axis=2)[:, :, ::-1][:, :, 1:]  # a tip turns all that are inside it
        return np.diff(self.base_angles(state), axis=1), np.diff(of_pairs, axis=1)

    @property
    def _behind(self) -> Array:
        """(n,) [m] from the plate back to where a tube is held, its shaft's compliance as a length of the tube."""
        return np.asarray(self.l_b - self.shaft * self.GJ)

    def _step(self, part: _Stretch, state: Array, at: float, h: float) -> Array:
        """A step of Nystroem's method of fourth order; the derivatives go along."""
        q, v = state[:, 0], state[:, 1]
        a1 = self._bent(part, q, at)
        a2 = self._bent(part, q + h / 2 * v + h * h / 8 * a1, at + h / 2)
        a3 = self._bent(part, q + h * v + h * h / 2 * a2, at + h)
        moved = np.stack([q + h * v + h * h / 6 * (a1 + 2 * a2), v + h / 6 * (a1 + 4 * a2 + a3)], axis=1)
        moved[:, :, : part.first] = state[:, :, : part.first]
        return np.asarray(moved)

    def _bent(self, part: _Stretch, q: Array, at: float) -> Array:
        """(Q, n, 1 + n) second derivatives of the angles, and of their derivatives."""
        u, w = self._turned(part, q[..., 0], at)
        total = w.sum()
        share = w / (self.GJ * total)
        sum_u = np.einsum("j,qjc->qc", w, u)
        cross = u[..., 0] * sum_u[:, None, 1] - u[..., 1] * sum_u[:, None, 0]
        dots = np.einsum("qic,qjc->qij", u, u) * w
        own = dots.sum(axis=2) - np.einsum("qii->qi", dots)
        K = -share[:, None] * dots
        K[:, np.arange(self.n), np.arange(self.n)] = share * own
        return np.concatenate([(-share * cross)[..., None], K @ q[..., 1:]], axis=2)

    def _turned(self, part: _Stretch, theta: Array, at: float) -> tuple[Array, Array]:
        """(Q, n, 2) precurvatures in the frame that does not twist, and (n,) bending stiffnesses of who is present."""
        given = part.u + at * part.slope
        c, s = np.cos(theta), np.sin(theta)
        u = np.stack([c * given[:, 0] - s * given[:, 1], s * given[:, 0] + c * given[:, 1]], axis=2)
        return u, np.where(np.arange(self.n) >= part.first, self.EI, 0.0)

    def equilibrium(self, psi: Array, outermost_rad: float) -> Equilibrium:
        """The shape of a root where the outermost collar stands at an angle."""
        dets: list[Array] = []
        state = self.shoot(psi[None], dets)
        behind = np.linspace(0, 1, COLLAR_STEPS + 1)[1:]
        dets += [np.linalg.det(state[:, 0, :, 1:] + x * self._behind[:, None] * state[:, 1, :, 1:]) for x in behind]
        is_stable = bool(np.all(np.array(dets) > 0))
        energy = float(np.sum(self.GJ / 2 * state[0, 1, :, 0] ** 2 * -self._behind))
        R, p, q = np.eye(3), np.zeros(3), state[..., :1].repeat(1 + self.n, axis=3)
        q[:, 0, :, 0] += outermost_rad - self.base_angles(state)[0, 0]
        for part in self.stretches:
            count = max(1, int(np.ceil((part.end - part.begin) / STEP_M * 4)))
            h = (part.end - part.begin) / count
            for k in range(count):
                q = self._step(part, q, k * h, h / 2)
                u, w = self._turned(part, q[:, 0, :, 0], (k + 0.5) * h)
                mean = np.einsum("j,jc->c", w, u[0]) / w.sum()
                stored = w @ ((u[0] - mean) ** 2).sum(axis=1) / 2 + (self.GJ * (w > 0)) @ q[0, 1, :, 0] ** 2 / 2
                energy += float(stored) * h
                p, R = _advanced(p, R, np.append(mean, 0.0), h)
                q = self._step(part, q, (k + 0.5) * h, h / 2)
        twist = self.relative(state)[0][0] - psi if self.n > 1 else np.zeros(0)
        return Equilibrium(p, np.remainder(psi, 2 * np.pi), twist, energy, is_stable)


def _advanced(p: Array, R: Array, u: Array, h: float) -> tuple[Array, Array]:
    """A position and a frame after an arc of length h and curvature vector u [1/m]."""
    angle = float(np.linalg.norm(u)) * h
    axis = u / max(float(np.linalg.norm(u)), 1e-300)
    X = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(angle) * X + (1 - np.cos(angle)) * X @ X
    if angle < 1e-9:
        return p + R[:, 2] * h, R @ turn
    along = np.eye(3) * h + (1 - np.cos(angle)) / angle * h * X + (angle - np.sin(angle)) / angle * h * X @ X
    return p + R @ along @ np.array([0.0, 0.0, 1.0]), R @ turn


def _stretches(tubes: tuple[Tube, ...], l_b: Array) -> list[_Stretch]:
    """From the plate to the tip; where tubes end in order, the inner ones farther out."""
    breaks, ends = {0.0}, [float(l + tube.length_m) for l, tube in zip(l_b, tubes, strict=True)]  # noqa: E741
    for tube, begin in zip(tubes, l_b.tolist(), strict=True):
        at = begin
        for section in tube.sections:
            at += section.length_m
            breaks.add(max(at, 0.0))
    results, points = list[_Stretch](), sorted(breaks)
    for a, b in itertools.pairwise(points):
        if b - a < 1e-9:
            continue
        middle = (a + b) / 2
        first = next(i for i in range(len(tubes)) if max(ends[i:]) > middle and ends[i] > middle)
        pieces = [_precurvature(tube, middle - begin, a - begin) for tube, begin in zip(tubes, l_b, strict=True)]
        u, slope = (np.array(part) for part in zip(*pieces, strict=True))
        results.append(_Stretch(a, b, first, u, slope))
    return results


def _precurvature(tube: Tube, inside: float, at: float) -> tuple[list[float], list[float]]:
    """Precurvature (2,) [1/m] at `at`, and its slope, of the section that `inside` lies in; lengths from the base."""
    begin = 0.0
    for section in tube.sections:
        if begin < inside < begin + section.length_m:
            mean = np.array([section.curvature_x_per_m, section.curvature_y_per_m])
            slope = 2 * section.gradient / section.length_m
            return (mean * (1 - section.gradient + slope * (at - begin))).tolist(), (mean * slope).tolist()
        begin += section.length_m
    return [0.0, 0.0], [0.0, 0.0]
