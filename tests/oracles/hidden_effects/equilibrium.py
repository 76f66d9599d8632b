"""Equilibrium of all rods with contact, friction and loads: Newton's method on all unknowns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from hidden_effects.contact import Contact, Distances, Pair
from hidden_effects.mesh import Fineness, stations
from hidden_effects.rod import Curve, Rod
from hidden_effects.start import common_centreline
from hidden_effects.tube import Array, Tube

HIGHEST_BARRIER = 3e4  # [N/m] at which every contact is centred
CORNER_BARRIER = 30.0  # at which friction is switched on
LOWEST_BARRIER = 0.3
BARRIER_FACTOR = 30.0
KEPT = 0.02  # of every gap and multiplier in a step
LARGEST_TURN_RAD = 0.6
CONVERGED_M = 5e-6  # the next step would move the tip by about a hundredth of the noise
NEAR_M = 1e-3  # steps that allow the barrier to fall
MOST_STEPS = 150
CONTACT_SHARE = 0.03  # of a pair's largest force, above which a place counts as contact
CONTACT_APART_M = 4e-3

# friction state of every station of a pair and its derivative with respect to all unknowns, of the present unknowns
FrictionState = Callable[["System", "State", int], tuple[Array, Array | None]]


class NoEquilibrium(RuntimeError):
    """Newton's method did not end."""


@dataclass(frozen=True)
class Loads:
    """Force on the foremost tip [N]; direction in which the tubes' weights act. World frame."""

    tip_force_N: tuple[float, float, float] = (0.0, 0.0, 0.0)
    down: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass
class State:
    """All unknowns x, and per pair the multipliers and gaps of its stations."""

    x: Array
    lam: list[Array]
    w: list[Array]
    barrier: float
    steps: int = 0
    curves: list[Curve] = field(default_factory=list)
    distances: list[Distances] = field(default_factory=list)

    def copy(self) -> State:
        return replace(self, x=self.x.copy(), lam=[a.copy() for a in self.lam], w=[a.copy() for a in self.w])


class System:
    """Tubes at actuator rotations theta_b and collar translations l_b; solves for states."""

    def __init__(
        self,
        tubes: Sequence[Tube],
        pairs: Sequence[Pair],
        theta_b: Array,
        l_b: Array,
        loads: Loads | None = None,
        fineness: Fineness | None = None,
        contacts_m: Sequence[float] = (),
    ) -> None:
        mesh = fineness or Fineness()
        self.tubes, self.theta_b, self.loads = tubes, np.asarray(theta_b, float), loads or Loads()
        self.l_b = np.asarray(l_b, float)
        self.s = stations(tubes, self.l_b, mesh, contacts_m)
        self.rods = [
            Rod(tube, base, self.s, mesh.links_per_node) for tube, base in zip(tubes, l_b.tolist(), strict=True)
        ]
        self.rods[0].guide()
        self.contacts = [
            Contact(pair, outer, inner, self.s)
            for pair, outer, inner in zip(pairs, self.rods[:-1], self.rods[1:], strict=True)
        ]
        sizes = [rod.n_bend + rod.n_twist for rod in self.rods]
        self.start = np.concatenate([[0], np.cumsum(sizes)])
        self.free = self._free()
        self.turning = np.concatenate([np.r_[np.zeros(r.n_bend), np.ones(r.n_twist)] for r in self.rods]) > 0

    @property
    def foremost(self) -> int:
        """The rod that ends at the robot's tip, the innermost of several."""
        return max(range(len(self.rods)), key=lambda i: (self.rods[i].last, i))

    def _free(self) -> Array:
        free = np.ones(self.start[-1], dtype=bool)
        for rod, start in zip(self.rods, self.start, strict=False):
            free[start : start + rod.n_bend] = np.repeat(rod.bend.any(axis=0), 2)
            free[start + rod.n_bend] = rod.tube.shaft_compliance_rad_per_Nm > 0
        return np.flatnonzero(free)

    def parts(self, x: Array, i: int) -> tuple[Array, Array]:
        """Nodal curvatures (2N,) and angles (N',) of rod i."""
        a, n = self.start[i], self.rods[i].n_bend
        return x[a : a + n], x[a + n : self.start[i + 1]]

    def with_tubes(self, tubes: Sequence[Tube]) -> System:
        """This system with tubes of other material and precurvature, and unchanged lengths and joints."""
        other = copy(self)
        other.tubes, other.rods = tubes, [rod.of(tube) for rod, tube in zip(self.rods, tubes, strict=True)]
        return other

    def contact_places(self, state: State) -> list[float]:
        """Arc lengths around which contact forces concentrate."""
        places: list[float] = []
        for contact, lam in zip(self.contacts, state.lam, strict=True):
            pressed = lam > CONTACT_SHARE * lam.max()
            groups = np.split(
                np.flatnonzero(pressed), np.flatnonzero(np.diff(contact.s[pressed]) > CONTACT_APART_M) + 1
            )
            places += [float(np.average(contact.s[group], weights=lam[group])) for group in groups]
        return [s for k, s in enumerate(places) if all(abs(s - other) > CONTACT_APART_M / 2 for other in places[:k])]

    def elastic_gradient(self, x: Array) -> Array:
        """What the elastic energy contributes to the imbalance."""
        return np.concatenate([rod.elastic(*self.parts(x, i))[0] for i, rod in enumerate(self.rods)])

    def cold(self) -> State:
        """The start on a common centreline."""
        kappa, angles = common_centreline(self.rods, self.theta_b, len(self.s) - 1)
        x = np.concatenate([part for pair in zip(kappa, angles, strict=True) for part in pair])
        w = [np.full(len(c.s), c.pair.clearance_m**2 / 2) for c in self.contacts]
        lam = [HIGHEST_BARRIER * c.pair.clearance_m * c.share / gap for c, gap in zip(self.contacts, w, strict=True)]
        return State(x, lam, w, HIGHEST_BARRIER)

    def solve(
        self, state: State, friction: FrictionState, lowest: float = LOWEST_BARRIER, converged: float = CONVERGED_M
    ) -> State:
        """Newton's method from a copy of `state`, the barrier falling to `lowest`. Raises NoEquilibrium."""
        state = state.copy()
        for _ in range(MOST_STEPS):
            moved, share = self._step(state, friction)
            if share == 1.0 and moved < NEAR_M and state.barrier > lowest:
                state.barrier = max(lowest, state.barrier / BARRIER_FACTOR)
            elif share == 1.0 and moved < converged and state.barrier == lowest:
                return state
        raise NoEquilibrium(f"moved by {moved:.1e} m in step {MOST_STEPS}")

    def look(self, state: State) -> None:
        """Centrelines and distances at the unknowns of the state."""
        state.curves = [rod.curve(self.parts(state.x, i)[0]) for i, rod in enumerate(self.rods)]
        state.distances = [c.distances(state.curves[i], state.curves[i + 1]) for i, c in enumerate(self.contacts)]

    def residual(self, state: State, friction: FrictionState) -> tuple[Array, Array]:
        """Imbalance of all unknowns x with the multipliers eliminated, and its derivative."""
        self.look(state)
        R, H = np.zeros(self.start[-1]), np.zeros((self.start[-1], self.start[-1]))
        forces = [np.zeros((len(rod.s), 3)) for rod in self.rods]
        for k in range(len(self.contacts)):
            self._add_contact(state, k, friction, R, H, forces)
        self._add_loads(state, R, forces)
        for i, (rod, curve) in enumerate(zip(self.rods, state.curves, strict=True)):
            all_of, bend = slice(self.start[i], self.start[i + 1]), slice(self.start[i], self.start[i] + rod.n_bend)
            gradient, hessian = rod.elastic(*self.parts(state.x, i))
            R[all_of] += gradient
            H[all_of, all_of] += hessian
            H[bend, bend] += rod.geometric_stiffness(curve, forces[i])
            if rod.tube.shaft_compliance_rad_per_Nm > 0:
                base = self.start[i] + rod.n_bend
                R[base] += (state.x[base] - self.theta_b[i]) / rod.tube.shaft_compliance_rad_per_Nm
                H[base, base] += 1 / rod.tube.shaft_compliance_rad_per_Nm
        return R, H

    def _add_contact(
        self, state: State, k: int, friction: FrictionState, R: Array, H: Array, forces: list[Array]
    ) -> None:
        contact, near, lam, w = self.contacts[k], state.distances[k], state.lam[k], state.w[k]
        pair, d = contact.pair, near.d
        eps = state.barrier * pair.clearance_m * contact.share
        square = np.sum(d * d, axis=1)
        corrected = (eps + lam * (w + square / 2 - pair.clearance_m**2 / 2)) / w
        phi, slope = friction(self, state, k)
        mu = pair.friction
        quarter = np.column_stack([-d[:, 1], d[:, 0]])
        push = d + (phi * mu)[:, None] * quarter  # force per multiplier
        J = np.concatenate([near.outer, near.inner], axis=2)
        flat = J.reshape(-1, J.shape[2])
        bend = np.r_[
            self.start[k] : self.start[k] + self.rods[k].n_bend,
            self.start[k + 1] : self.start[k + 1] + self.rods[k + 1].n_bend,
        ]
        A = np.eye(2) + (phi * mu)[:, None, None] * np.array([[0.0, -1.0], [1.0, 0.0]])
        stiff = lam[:, None, None] * A + (lam / w)[:, None, None] * push[:, :, None] * d[:, None, :]
        R[bend] += flat.T @ (corrected[:, None] * push).ravel()
        H[np.ix_(bend, bend)] += flat.T @ (stiff @ J).reshape(flat.shape)
        world = np.einsum("kij,ki->kj", near.plane, lam[:, None] * push)
        forces[k][contact.at[0]] += world
        forces[k + 1][contact.at[1]] -= world
        if mu == 0 or (slope is None and not phi.any()):
            return
        rows = np.concatenate(contact.torques(state.curves[k], state.curves[k + 1]), axis=1)
        every = np.r_[self.start[k] : self.start[k + 2]]
        R[every] -= rows.T @ (phi * mu * corrected * square / pair.clearance_m)
        lever = (phi * mu / pair.clearance_m * (lam / w * square + 2 * lam))[:, None] * np.einsum("ki,kin->kn", d, J)
        H[np.ix_(every, bend)] -= rows.T @ lever
        if slope is not None:
            H[np.ix_(bend, every)] += flat.T @ (
                ((lam * mu)[:, None] * quarter)[:, :, None] * slope[:, None, :]
            ).reshape(len(flat), -1)
            H[np.ix_(every, every)] -= rows.T @ ((mu * lam * square / pair.clearance_m)[:, None] * slope)

    def _add_loads(self, state: State, R: Array, forces: list[Array]) -> None:
        for i, (rod, curve) in enumerate(zip(self.rods, state.curves, strict=True)):
            load = np.zeros_like(curve.p)
            if rod.tube.weight_N_per_m:
                share = np.append(rod.h, 0) / 2 + np.insert(rod.h, 0, 0) / 2
                load += rod.tube.weight_N_per_m * share[:, None] * np.array(self.loads.down)
            if i == self.foremost:
                load[-1] += self.loads.tip_force_N
            if load.any():
                R[self.start[i] : self.start[i] + rod.n_bend] -= np.einsum("kin,ki->n", curve.moved, load)
                forces[i] += load

    def _step(self, state: State, friction: FrictionState) -> tuple[float, float]:
        """One Newton step; the largest displacement of a tip or of a bore [m], and the share of the step taken."""
        R, H = self.residual(state, friction)
        step = np.zeros_like(R)
        step[self.free] = -np.linalg.solve(H[np.ix_(self.free, self.free)], R[self.free])
        share = min(1.0, LARGEST_TURN_RAD / max(float(np.abs(step[self.turning]).max()), 1e-300))
        moves = []
        for k, (contact, near) in enumerate(zip(self.contacts, state.distances, strict=True)):
            lam, w = state.lam[k], state.w[k]
            delta = near.outer @ self.parts(step, k)[0] + near.inner @ self.parts(step, k + 1)[0]
            gap = w + np.sum(near.d**2, axis=1) / 2 - contact.pair.clearance_m**2 / 2
            dw = -gap - np.sum(near.d * delta, axis=1)
            dlam = (state.barrier * contact.pair.clearance_m * contact.share - lam * w - lam * dw) / w
            moves.append((dlam, dw))
            for value, change in ((lam, dlam), (w, dw)):
                worst = float(np.max(-change / value))
                share = min(share, (1 - KEPT) / worst if worst > 1 - KEPT else 1.0)
        for k, (dlam, dw) in enumerate(moves):
            state.lam[k] = state.lam[k] + share * dlam
            state.w[k] = state.w[k] + share * dw
        state.x = state.x + share * step
        state.steps += 1
        tip = state.curves[self.foremost].moved[-1] @ self.parts(step, self.foremost)[0]
        turn = 1e-3 * float(np.abs(step[self.turning]).max())  # 1 mm radius
        return max(float(np.linalg.norm(tip)), turn), share


def corner(phi: Sequence[float]) -> FrictionState:
    """One share of the Coulomb limit at all stations of a pair: +-1 loaded by rotation, 0 released."""

    def state_of(system: System, state: State, k: int) -> tuple[Array, Array | None]:
        return np.full(len(system.contacts[k].s), float(phi[k])), None

    return state_of


def tip_pose(system: System, state: State) -> tuple[Array, Array]:
    """Tip position (3,) [m] and the tip's material frame (3, 3), of the foremost tube."""
    system.look(state)
    curve = state.curves[system.foremost]
    angle = system.parts(state.x, system.foremost)[1][-1]
    c, s = np.cos(angle), np.sin(angle)
    return curve.p[-1], curve.Q[-1] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
