"""The zero-clearance model (2)-(3) with what the compiled one leaves out: loads, weight, ovality and softening.

All tubes share one centreline. With m(s) the moment of the loads beyond s, the common curvature solves
sum_i M_i = m across the tangent, and GJ_i theta_i'' = -M_i . J kappa turns every tube, M_i by (f) of docs/model.md.
Unknown at the plate are the n twist rates and the two bending moments; at the tips they leave no torque and no moment
but those of the loads. Configurations are integrated side by side (Runge-Kutta of fourth order between the ends of
sections), the unknowns found by Newton's method along growing loads from the solution without them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import Shape, Status, TubeShape
from ctrplan.mechanics.tube import Loads, Tube

STEP_M = 5e-3  # longest of the integration; halving it moves no tip by more than 2e-8 m (test)
STATION_M = 2e-3  # between the stations of a shape
NEWTON_STEPS, LOAD_STEPS = 12, 32  # for one load, and parts into which a load is divided at most: budgets
SETTLED = 1e-10  # of what is left at the tips over the largest moment of a precurvature
SMALL = 1e-7  # step of the unknowns over their size, for derivatives
LEAST_MOMENT_NM = 1e-6  # that counts as a scale, of straight tubes
SOFTENING_STEPS = 30  # by which softened tubes share a bend, half of Newton's, then of a fixed point: a budget
ROWS_AT_ONCE = 256  # integrated side by side, with n + 3 variants each


def is_beyond_standard(tubes: Sequence[Tube], loads: Loads) -> bool:
    """Whether a robot has terms that the compiled zero-clearance model leaves out."""
    has_loads = any(any(vector) for vector in (loads.tip_force_N, loads.tip_moment_Nm))
    has_weight = any(loads.gravity_m_s2) and any(tube.density_kg_m3 for tube in tubes)
    return has_loads or has_weight or any(tube.ovality or _softens(tube) for tube in tubes)


def _softens(tube: Tube) -> bool:
    return tube.softening_fraction < 1 and bool(np.isfinite(tube.softening_strain))


@dataclass(frozen=True, eq=False)
class LoadedRows:
    """K configurations solved; the spans between the ends of sections in front of the plate are S."""

    tip_m: Array  # (K, 3) of the innermost tube
    tangent: Array  # (K, 3)
    residual: Array  # (K,) what is left at the tips over the largest moment of a precurvature
    solved: NDArray[np.bool_]  # (K,)
    start: Array  # (K, n + 2) unknowns at the plate


class LoadedRobot:
    """The tubes and loads of a robot, to be solved at many configurations."""

    def __init__(self, tubes: Sequence[Tube], loads: Loads) -> None:
        """Tubes outermost first; loads in the world frame."""
        self.tubes, self.n = tuple(tubes), len(tubes)
        self.force, self.moment = np.array(loads.tip_force_N), np.array(loads.tip_moment_Nm)
        self.weight = np.array([tube.mass_per_length_kg_m for tube in tubes])[:, None] * np.array(loads.gravity_m_s2)
        self.EI = np.array([tube.bending_stiffness_Nm2 for tube in tubes])
        self.GJ = np.array([tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio) for tube in tubes])
        self.shaft = np.array([tube.shaft_compliance_rad_per_Nm for tube in tubes])
        self.ovality = np.array([tube.ovality for tube in tubes])
        self.axis = np.array([tube.ovality_axis_rad for tube in tubes])
        self.knee = np.array(
            [2 * t.softening_strain / t.outer_diameter_m if _softens(t) else np.inf for t in tubes]
        )  # 1/m
        self.fraction = np.array([t.softening_fraction if _softens(t) else 1.0 for t in tubes])
        curved = [t.bending_stiffness_Nm2 * max(s.curvature_per_m for s in t.pieces) for t in tubes]
        self.scale = max(LEAST_MOMENT_NM, *curved)

    def rows(self, theta_b: Array, l_b: Array, twist: Array) -> LoadedRows:
        """Solutions at collars (K, n) [rad], (K, n) [m] from twist rates (K, n) [1/m] at the plate without loads."""
        with np.errstate(all="ignore"):  # of steps that lead too far, which are not taken
            return self._rows(theta_b, l_b, twist)

    def _rows(self, theta_b: Array, l_b: Array, twist: Array) -> LoadedRows:
        work = _Spans(self, theta_b, l_b)
        x = np.hstack([twist * self.GJ, np.zeros((len(twist), 2))])  # torques and moments, N m
        share, step = np.zeros(len(x)), np.ones(len(x))
        for done in range(LOAD_STEPS):
            open_rows = np.flatnonzero((share < 1) & (share + step * (LOAD_STEPS - done) >= 1))  # that can still end
            if not len(open_rows):
                break
            aim = np.minimum(1.0, share[open_rows] + step[open_rows])
            moved, left = work.newton(open_rows, x[open_rows], aim)
            good = left < SETTLED
            x[open_rows[good]], share[open_rows[good]] = moved[good], aim[good]
            step[open_rows[~good]] /= 2
        end, left = work.integrate(np.arange(len(x)), x, np.ones(len(x)))
        residual = np.abs(left).max(axis=1) / self.scale
        solved = (share == 1) & (residual < 10 * SETTLED)
        return LoadedRows(end.tip_m, end.tangent, residual, solved, x)

    def tips(
        self, theta_b: Array, l_b: Array, status: NDArray[np.int_], bare: Callable[[Array, Array], Any]
    ) -> tuple[Array, Array, NDArray[np.int_]]:
        """Tips (K, 3) [m], tangents (K, 3) and status (K,) at collars (K, n), (K, n), as `Mechanics.tips` returns them.

        status (K,): of the solutions without loads, which `bare` gives for a configuration.
        """
        able = np.flatnonzero(status < Status.FAILED)
        tip, tangent = np.full((2, len(status), 3), np.nan)
        status = status.copy()
        for rows in np.array_split(able, max(1, -(-len(able) // ROWS_AT_ONCE))):
            if not len(rows):
                continue
            twist = np.array([_twist_at_plate(bare(theta_b[k], l_b[k])) for k in rows.tolist()])
            result = self.rows(theta_b[rows], l_b[rows], twist)
            tip[rows], tangent[rows] = result.tip_m, result.tangent
            status[rows[~result.solved]] = Status.FAILED
        return tip, tangent, status

    def shape(self, theta_b: Array, l_b: Array, bare: Shape) -> Shape:
        """The shape at collars (n,), (n,), found from the shape without loads. Its strains are of bending, as there."""
        rows = self.rows(theta_b[None], l_b[None], _twist_at_plate(bare)[None])
        work = _Spans(self, theta_b[None], l_b[None])
        stations: list[_State] = []
        work.integrate(np.zeros(1, int), rows.start, np.ones(1), stations)
        tubes = tuple(work.tube_shape(i, stations, rows.start[0]) for i in range(self.n))
        status = bare.status if rows.solved[0] else Status.FAILED
        most = max(float(tube.strain.max(initial=0.0)) for tube in tubes)
        radius = np.interp(tubes[-1].s_m, bare.s_m, bare.radius_m)
        return replace(
            _copied(bare),
            tubes=tubes,
            radius_m=radius,
            status=status,
            residual=float(rows.residual[0]),
            max_strain=most,
        )


def _copied(bare: Shape) -> Shape:
    """A shape with all its arrays and without the core's solution, which is that without loads."""
    return Shape(**bare.__getstate__())


def _twist_at_plate(bare: Shape) -> Array:
    """(n,) rates [1/m] just in front of the plate."""
    rates = []
    for tube in bare.tubes:
        ahead = int(np.searchsorted(tube.s_m, 0.0, side="right"))
        rates.append(float(tube.curvature_per_m[min(ahead, len(tube.s_m) - 1), 2]))
    return np.array(rates)


@dataclass(frozen=True, eq=False)
class _State:
    """Frames, twists and moments of K configurations at one station."""

    s_m: Array  # (K,)
    p: Array  # (K, 3)
    R: Array  # (K, 3, 3) twist-free frame
    theta: Array  # (K, n)
    torque: Array  # (K, n) GJ theta'
    m: Array  # (K, 3) moment of what is beyond, world frame


@dataclass(frozen=True, eq=False)
class _End:
    tip_m: Array
    tangent: Array


class _Spans:
    """The pieces between ends of sections, in front of the plate, of K configurations at once."""

    def __init__(self, robot: LoadedRobot, theta_b: Array, l_b: Array) -> None:
        self.robot, self.theta_b, self.l_b = robot, theta_b, l_b
        begins = [np.cumsum([0.0, *(s.length_m for s in tube.pieces)]) for tube in robot.tubes]
        stations = np.concatenate([l_b[:, i : i + 1] + begins[i] for i in range(robot.n)], axis=1)
        self.stations = np.sort(np.concatenate([np.zeros((len(l_b), 1)), np.maximum(stations, 0.0)], axis=1), axis=1)
        self.tip_s = np.column_stack([l_b[:, i] + begins[i][-1] for i in range(robot.n)])

    def newton(self, rows: NDArray[np.int_], x: Array, share: Array) -> tuple[Array, Array]:
        """The unknowns (k, n + 2) after Newton's steps from x, and what is left (k,) over the scale."""
        x, count = x.copy(), x.shape[1]
        best, active = np.full(len(rows), np.inf), np.arange(len(rows))
        for _ in range(NEWTON_STEPS + 1):
            size, at = SMALL * self.robot.scale, x[active]
            moved = np.concatenate([at[None], at[None] + size * np.eye(count)[:, None, :]]).reshape(-1, count)
            _, left = self.integrate(np.tile(rows[active], count + 1), moved, np.tile(share[active], count + 1))
            left = left.reshape(count + 1, len(active), count)
            size_left = np.abs(left[0]).max(axis=1) / self.robot.scale
            best[active] = np.where(np.isfinite(size_left), size_left, np.inf)
            slope = (left[1:] - left[0]).transpose(1, 2, 0) / size
            usable = np.isfinite(slope).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(slope))) > 0)
            usable &= best[active] >= SETTLED
            active = active[usable]
            if not len(active):
                break
            x[active] -= np.linalg.solve(slope[usable], left[0][usable][..., None])[..., 0]
        return x, best

    def integrate(
        self, rows: NDArray[np.int_], x: Array, share: Array, kept: list[_State] | None = None
    ) -> tuple[_End, Array]:
        """From the plate to the tips; what is left there (K, n + 2) [N m], with shares (K,) of the loads."""
        robot, l_b, stations, tip_s = self.robot, self.l_b[rows], self.stations[rows], self.tip_s[rows]
        K, n = len(rows), robot.n
        torque = x[:, :n].copy()
        theta = self.theta_b[rows] + torque * (robot.shaft + np.maximum(-l_b, 0.0) / robot.GJ)
        m = np.column_stack([x[:, n:], torque.sum(axis=1)])
        state = _State(np.zeros(K), np.zeros((K, 3)), np.tile(np.eye(3), (K, 1, 1)), theta, torque, m)
        residual, end = np.zeros((K, n + 2)), _End(np.zeros((K, 3)), np.tile([0.0, 0.0, 1.0], (K, 1)))
        if kept is not None:
            kept.append(state)
        for a, b in zip(stations[:, :-1].T, stations[:, 1:].T, strict=True):
            length, middle = b - a, (a + b) / 2
            there = (l_b < middle[:, None]) & (middle[:, None] < tip_s)
            count = (
                int(np.ceil(length.max() / (STEP_M if kept is None else STATION_M) - 1e-9))
                if length.max() > 1e-12
                else 0
            )
            for _ in range(count):
                state = self._step(state, length / count, middle, there, l_b, tip_s, share)
                if kept is not None:
                    kept.append(state)
            ends = np.abs(tip_s - b[:, None]) < 1e-12
            residual[:, :n] = np.where(ends, state.torque, residual[:, :n])
            inner = ends[:, -1] & (length > 1e-12)
            if inner.any():
                load = robot.moment * share[:, None]
                t = state.R[:, :, 2]
                residual[inner, n - 1] -= np.einsum("kx,kx->k", load, t)[inner]
                end.tip_m[inner], end.tangent[inner] = state.p[inner], t[inner]
                state = replace(state, m=np.where(inner[:, None], state.m - load, state.m))
        across = np.einsum("kxi,kx->ki", state.R, state.m)[:, :2]
        residual[:, n:] = across
        return end, residual

    def _step(
        self, a: _State, h: Array, middle: Array, there: NDArray[np.bool_], l_b: Array, tip_s: Array, share: Array
    ) -> _State:
        """One step of Runge-Kutta's; frames are brought back to rotations."""

        def moved(slope: tuple[Array, ...], length: Array) -> _State:
            p, R, theta, torque, m = slope
            return _State(
                a.s_m + length,
                a.p + length[:, None] * p,
                a.R + length[:, None, None] * R,
                a.theta + length[:, None] * theta,
                a.torque + length[:, None] * torque,
                a.m + length[:, None] * m,
            )

        def rate(state: _State) -> tuple[Array, ...]:
            return self._rate(state, middle, there, l_b, tip_s, share)

        k1 = rate(a)
        k2 = rate(moved(k1, h / 2))
        k3 = rate(moved(k2, h / 2))
        k4 = rate(moved(k3, h))
        mean = tuple((w + 2 * x + 2 * y + z) / 6 for w, x, y, z in zip(k1, k2, k3, k4, strict=True))
        result = moved(mean, h)
        # one step towards the nearest rotation (Newton's for the polar factor)
        R = result.R @ (1.5 * np.eye(3) - 0.5 * result.R.transpose(0, 2, 1) @ result.R)
        return replace(result, R=R)

    def _rate(
        self, a: _State, middle: Array, there: NDArray[np.bool_], l_b: Array, tip_s: Array, share: Array
    ) -> tuple[Array, ...]:
        robot = self.robot
        kappa, moments = self.curvature(a, middle, there, l_b, share)
        turn = np.zeros_like(a.R)  # columns: R [kappa]x with kappa = d(tangent)/ds across
        turn[:, :, 2] = a.R[:, :, 0] * kappa[:, :1] + a.R[:, :, 1] * kappa[:, 1:]
        turn[:, :, 0] = -a.R[:, :, 2] * kappa[:, :1]
        turn[:, :, 1] = -a.R[:, :, 2] * kappa[:, 1:]
        twist = np.where(there, a.torque / robot.GJ, 0.0)
        # -M . J kappa, J kappa = (-kappa_y, kappa_x)
        torque = np.where(there, moments[..., 0] * kappa[:, None, 1] - moments[..., 1] * kappa[:, None, 0], 0.0)
        beyond = np.clip(tip_s - np.maximum(a.s_m[:, None], l_b), 0.0, None)
        force = np.where((middle < tip_s[:, -1])[:, None], robot.force, 0.0) + beyond @ robot.weight
        t = a.R[:, :, 2]
        return t, turn, twist, torque, -np.cross(t, force * share[:, None])

    def curvature(
        self, a: _State, middle: Array, there: NDArray[np.bool_], l_b: Array, share: Array
    ) -> tuple[Array, Array]:
        """Common curvature (K, 2) as change of the tangent in the twist-free frame, and moments (K, n, 2) of tubes."""
        robot = self.robot
        bent = _Bends(self._stiffness(a.theta), _turned(a.theta, self._precurvature(a.s_m, middle, l_b)), there)
        m = np.einsum("kxi,kx->ki", a.R, a.m)
        wanted = m[:, 1], -m[:, 0]  # a moment about y bends towards x
        f = np.where(there, 1.0, 0.0)
        soft = bool(np.isfinite(robot.knee).any()) and (share > 0).any()
        kappa = bent.balanced(f, wanted)
        with np.errstate(divide="ignore", invalid="ignore"):
            for done in range(SOFTENING_STEPS if soft else 0):
                rho = np.sqrt(np.maximum(bent.square(kappa) / robot.EI, 0.0))
                is_soft = there & (rho > robot.knee)
                lost = np.where(is_soft, share[:, None] * (1 - robot.fraction), 0.0)
                aim: Array = there - np.where(is_soft, lost * (1 - robot.knee / rho), 0.0)
                settled = np.abs(aim - f).max() < 1e-13
                f = aim
                if settled or done >= SOFTENING_STEPS // 2:
                    kappa = bent.balanced(f, wanted)
                else:
                    slope = np.where(is_soft, lost * robot.knee / (robot.EI * rho**3), 0.0)
                    kappa = bent.nearer(kappa, f, slope, wanted)
                if settled:
                    break
        return np.stack(kappa, axis=-1), np.stack([f * part for part in bent.moments(kappa)], axis=-1)

    def _stiffness(self, theta: Array) -> tuple[Array, Array, Array]:
        """Along x, across and along y (K, n) against changes of the common curvature."""
        robot = self.robot
        c, s = (robot.ovality * f(2 * (theta + robot.axis)) for f in (np.cos, np.sin))
        return robot.EI * (1 + c), robot.EI * s, robot.EI * (1 - c)

    def _precurvature(self, s: Array, middle: Array, l_b: Array) -> Array:
        """(K, n, 2) as change of the tangent in the tubes' own frames."""
        v = np.zeros((len(s), self.robot.n, 2))
        for i, tube in enumerate(self.robot.tubes):
            begin = l_b[:, i].copy()
            for section in tube.pieces:
                end = begin + section.length_m
                inside = (begin < middle) & (middle < end)
                factor = 1 + section.gradient * (2 * (s - begin) / section.length_m - 1)
                v[inside, i] = factor[inside, None] * (section.curvature_y_per_m, -section.curvature_x_per_m)
                begin = end
        return v

    def tube_shape(self, i: int, stations: Sequence[_State], x: Array) -> TubeShape:
        """Tube i (from 0) of the one configuration, from its collar to its tip."""
        robot, l, tip = self.robot, float(self.l_b[0, i]), float(self.tip_s[0, i])  # noqa: E741
        rows = [(a, float(a.s_m[0])) for a in stations if float(a.s_m[0]) <= tip + 1e-12]
        behind = np.unique(np.append(np.arange(l, 0.0, STATION_M), 0.0))[:-1] if l < 0 else np.zeros(0)
        rate = float(x[i] / robot.GJ[i])
        collar = float(self.theta_b[0, i] + x[i] * robot.shaft[i])
        s = np.concatenate([behind, [at for _, at in rows]])
        p = np.concatenate([np.column_stack([0 * behind, 0 * behind, behind]), np.array([a.p[0] for a, _ in rows])])
        theta = np.concatenate([collar + rate * (behind - l), [float(a.theta[0, i]) for a, _ in rows]])
        R = np.concatenate([np.tile(np.eye(3), (len(behind), 1, 1)), np.array([a.R[0] for a, _ in rows])])
        c, k = np.cos(theta), np.sin(theta)
        frames = np.stack(
            [
                R[:, :, 0] * c[:, None] + R[:, :, 1] * k[:, None],
                R[:, :, 1] * c[:, None] - R[:, :, 0] * k[:, None],
                R[:, :, 2],
            ],
            axis=2,
        )
        curvature, strain = np.zeros((len(s), 3)), np.zeros(len(s))
        curvature[:, 2] = np.concatenate(
            [np.full(len(behind), rate), [float(a.torque[0, i] / robot.GJ[i]) for a, _ in rows]]
        )
        for k_row, at in enumerate(s.tolist()):
            middle = np.array([min(max(at - 1e-9, l + 1e-9), tip - 1e-9) if at >= tip - 1e-9 else at + 1e-9])
            v = self._precurvature(np.array([at]), middle, self.l_b)[0, i]
            kappa = np.zeros(2)
            if k_row >= len(behind):
                state = rows[k_row - len(behind)][0]
                present = (self.l_b < middle[:, None]) & (middle[:, None] < self.tip_s)
                kappa = self.curvature(state, middle, present, self.l_b, np.ones(1))[0][0]
            own = np.array(
                [
                    np.cos(theta[k_row]) * kappa[0] + np.sin(theta[k_row]) * kappa[1],
                    np.cos(theta[k_row]) * kappa[1] - np.sin(theta[k_row]) * kappa[0],
                ]
            )
            curvature[k_row, :2] = -own[1], own[0]  # as a rotation rate
            strain[k_row] = robot.tubes[i].outer_diameter_m / 2 * float(np.linalg.norm(own - v))
        return TubeShape(s, p, frames, theta, curvature, strain)


@dataclass(frozen=True, eq=False)
class _Bends:
    """Tubes at one station of K configurations, which share a bend; written out by components, as arrays are small."""

    stiffness: tuple[Array, Array, Array]  # (K, n) along x, across, along y
    own: Array  # (K, n, 2) precurvatures in the twist-free frame
    there: NDArray[np.bool_]  # (K, n)

    def moments(self, kappa: tuple[Array, Array]) -> tuple[Array, Array]:
        """What each tube (K, n) takes at a common curvature (K,), (K,) before it softens."""
        xx, xy, yy = self.stiffness
        x, y = (k[:, None] - self.own[..., i] for i, k in enumerate(kappa))
        return xx * x + xy * y, xy * x + yy * y

    def square(self, kappa: tuple[Array, Array]) -> Array:
        """(K, n) changes of curvature by their moments: EI times the square where a tube is round."""
        x, y = self.moments(kappa)
        square: Array = x * (kappa[0][:, None] - self.own[..., 0]) + y * (kappa[1][:, None] - self.own[..., 1])
        return square

    def balanced(self, f: Array, wanted: tuple[Array, Array]) -> tuple[Array, Array]:
        """The common curvature (K,), (K,) at which tubes softened to shares f (K, n) bear a moment; 0 without tubes."""
        none = np.zeros(len(f))
        return self.nearer((none, none), f, np.zeros_like(f), wanted)

    def nearer(
        self, kappa: tuple[Array, Array], f: Array, slope: Array, wanted: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """A step of Newton's from a curvature, where shares fall by `slope` (K, n) times what a change does by moments.

        Where they do not fall it is the solution.
        """
        moments, (xx, xy, yy) = self.moments(kappa), self.stiffness
        left = [w - (f * part).sum(axis=1) for w, part in zip(wanted, moments, strict=True)]
        a = (f * xx - slope * moments[0] ** 2).sum(axis=1)
        b = (f * xy - slope * moments[0] * moments[1]).sum(axis=1)
        c = (f * yy - slope * moments[1] ** 2).sum(axis=1)
        det = np.where(self.there.any(axis=1), a * c - b * b, np.inf)
        return kappa[0] + (c * left[0] - b * left[1]) / det, kappa[1] + (a * left[1] - b * left[0]) / det


def _turned(theta: Array, v: Array) -> Array:
    """Vectors (K, n, 2) of the tubes' frames in the twist-free frame."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)
