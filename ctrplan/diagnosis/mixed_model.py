"""The mixed model of a diagnosis: residuals as parameters, random errors of every stage, and noise; its evidence.

    residual = J (p - prior centre) + sum of F_k g_k + sum of errors smooth in something + noise

Everything but the sizes of the random parts is integrated out: parameters over their priors, F_k g_k over g_k ~ N(0,
lambda_k). The evidence is the logarithm of the density of all measured numbers, with the most probable sizes and the
density of these under their own prior. It is the restricted likelihood (REML) of the sizes where priors are flat.

Random parts come in two forms. *Kernels* (K, K) act alike on the coordinates of position, or on those of the tangent,
so that one Cholesky factor of K poses serves them all. *Loaded* parts (K, 5, R) act through the chain's derivatives, in
few columns, which the matrix inversion lemma adds. A step of Newton's method costs K^3 + 5 K R^2 instead of (5 K)^3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from ctrplan.base.arrays import Array

Kind = Literal["position", "tangent"]
CHANNELS: dict[Kind, tuple[int, ...]] = {"position": (0, 1, 2), "tangent": (3, 4)}
NOISE_SPREAD = 0.3  # of the logarithm of the noise's variance: a data sheet is good to about 15 % of a deviation
LEAST_NOISE = -0.9  # of the stated variance that may be missing
NEGLIGIBLE = 5e-4  # variance over the noise's, below which a part is nothing
MOST_STEPS, ENOUGH = 14, 0.05  # of Newton's method for the sizes; log-units that end it


@dataclass(frozen=True, eq=False)
class Kernel:
    """An error (K, K) that acts alike on all coordinates of its kind; mean variance 1, the noise's."""

    name: str
    kind: Kind
    matrix: Array


@dataclass(frozen=True, eq=False)
class Loaded:
    """An error through the columns (K, 5, R); mean variance 1, the noise's."""

    name: str
    columns: Array


@dataclass(frozen=True, eq=False)
class Sizes:
    """Variances over the noise's, of each kernel and each loaded part; of the noise what it has more than stated."""

    kernels: Array
    loaded: Array
    noise: Array  # (2,) of position and tangent, above LEAST_NOISE

    @property
    def vector(self) -> Array:
        """All in one."""
        return np.concatenate([self.kernels, self.loaded, self.noise])


@dataclass(frozen=True, eq=False)
class Posterior:
    """What linear residuals say: the evidence, parameters over their priors, and the sizes it is for."""

    evidence: float  # log density of the data, at the most probable parameters of the linearised model
    parameters: Array  # (P,) most probable, over the priors' deviations, from their centres
    precision: Array  # (P, P) of these
    sizes: Sizes
    gradient: Array  # of the evidence by the sizes

    def at(self, parameters: Array) -> float:
        """The evidence if the most probable parameters were these (P,), as Laplace's method has it at them."""
        away = parameters - self.parameters
        return float(self.evidence - 0.5 * away @ self.precision @ away)


@dataclass(frozen=True, eq=False)
class Information:
    """Residuals as seen by parameters (P,) over their priors, of which any may be in a model."""

    without: float  # evidence without any of them
    precision: Array  # (P, P) J^T V^-1 J
    slope: Array  # (P,) J^T V^-1 y

    def evidence(self, which: NDArray[np.int_] | Sequence[int]) -> float:
        """With some of the parameters."""
        at = np.asarray(which)
        if not len(at):
            return self.without
        L = np.linalg.cholesky(np.eye(len(at)) + self.precision[np.ix_(at, at)])
        w = solve_triangular(L, self.slope[at], lower=True, check_finite=False)
        return float(self.without + 0.5 * w @ w - np.log(np.diag(L)).sum())


@dataclass(frozen=True, eq=False)
class _Group:
    """Channels that were measured at the same poses."""

    kind: Kind
    poses: NDArray[np.int_]
    channels: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _State:
    """The model at given sizes, with parameters (P,) in it."""

    evidence: float
    factors: list[Array]  # of the covariance of each group
    columns: Array  # (N, A + P) whitened: active loaded columns times the root of their sizes, then parameters
    root: Array  # (A + P, A + P) lower factor of I + columns^T columns
    residual: Array  # (N,) whitened
    solved: Array  # (A + P,) root^-1 columns^T residual


class MixedModel:
    """Kernels, loaded parts and noise of K poses, of which `given` (K, 5) numbers were measured."""

    def __init__(
        self, given: NDArray[np.bool_], shared: tuple[Array, Array], kernels: Sequence[Kernel], loaded: Sequence[Loaded]
    ) -> None:
        """shared: covariances (K, K) over the noise's of position and tangent that are there in any case."""
        self.given, self.kernels, self.loaded, self.shared = given, tuple(kernels), tuple(loaded), shared
        self.groups = _groups(given)
        self.count = int(given.sum())
        self._stack = [
            np.array([k.matrix[np.ix_(g.poses, g.poses)] for k in self.kernels if k.kind == g.kind]).reshape(
                -1, len(g.poses), len(g.poses)
            )
            for g in self.groups
        ]
        self._place = {
            kind: np.array([i for i, k in enumerate(self.kernels) if k.kind == kind], dtype=np.int_)
            for kind in CHANNELS
        }
        widths = [part.columns.shape[2] for part in self.loaded]
        self._of = np.repeat(np.arange(len(widths)), widths)
        joined = [part.columns for part in self.loaded] or [np.zeros((len(given), 5, 0))]
        self._columns = np.concatenate(joined, axis=2)

    @property
    def names(self) -> tuple[str, ...]:
        """Of kernels, then of loaded parts."""
        return (*(k.name for k in self.kernels), *(part.name for part in self.loaded))

    def start(self, size: float = 0.1) -> Sizes:
        """Every part of the same size, and the noise as stated."""
        return Sizes(np.full(len(self.kernels), size), np.full(len(self.loaded), size), np.zeros(2))

    def named(self, known: Mapping[str, float], noise: Array) -> Sizes:
        """Sizes of parts by their names, 0 of others."""
        sizes = np.array([known.get(name, 0.0) for name in self.names])
        return Sizes(sizes[: len(self.kernels)], sizes[len(self.kernels) :], noise)

    def only(self, kept: NDArray[np.bool_], sizes: Sizes) -> tuple[MixedModel, Sizes]:
        """The model of some of the parts, a mask in the order of `names`, and their sizes."""
        of_kernels, of_loaded = kept[: len(self.kernels)], kept[len(self.kernels) :]
        kernels = [k for k, there in zip(self.kernels, of_kernels, strict=True) if there]
        loaded = [part for part, there in zip(self.loaded, of_loaded, strict=True) if there]
        less = MixedModel(self.given, self.shared, kernels, loaded)
        return less, Sizes(sizes.kernels[of_kernels], sizes.loaded[of_loaded], sizes.noise)

    def posterior(self, y: Array, J: Array, sizes: Sizes, steps: int = MOST_STEPS) -> Posterior:
        """Of residuals y (K, 5) at the priors' centres with derivatives J (K, 5, P) by parameters over their priors.

        The sizes start at `sizes` and take at most so many steps of Newton's method, each with the average of expected
        and observed information; where a step fails it is shortened.
        """
        numbers, design = self._flat(y), self._flat(J)
        state = self._at(numbers, design, sizes)
        gradient = np.zeros(0)
        for _ in range(steps):
            gradient, step, free = self._newton(state, sizes)
            if not free.any():
                break
            share, better = 1.0, None
            while share > 0.01 and better is None:
                trial = _moved(sizes, share * step, free)
                there = self._at(numbers, design, trial)
                if there.evidence > state.evidence - 1e-6:
                    better = there, trial
                share *= 0.35
            if better is None:
                break
            gain = better[0].evidence - state.evidence
            state, sizes = better
            if gain < ENOUGH:
                break
        a = state.columns.shape[1] - J.shape[2]
        L = state.root[a:, a:]
        parameters = solve_triangular(L, state.solved[a:], lower=True, trans="T")
        return Posterior(state.evidence, parameters, L @ L.T, sizes, gradient)

    def information(self, y: Array, J: Array, sizes: Sizes) -> Information:
        """What residuals (K, 5) say about any of many parameters over their priors, (K, 5, P), at given sizes."""
        state = self._at(self._flat(y), np.zeros((self.count, 0)), sizes)
        whole, at = self._flat(J), 0
        for g, L in zip(self.groups, state.factors, strict=True):
            for _ in g.channels:
                n = len(g.poses)
                whole[at : at + n] = solve_triangular(L, whole[at : at + n], lower=True, check_finite=False)
                at += n
        crossed = solve_triangular(state.root, state.columns.T @ whole, lower=True, check_finite=False)
        precision = whole.T @ whole - crossed.T @ crossed
        return Information(state.evidence, precision, whole.T @ state.residual - crossed.T @ state.solved)

    def explained(self, y: Array, J: Array, sizes: Sizes) -> dict[str, Array]:
        """(K, 5) the most probable error of each part, at these residuals with parameters in the model."""
        state = self._at(self._flat(y), self._flat(J), sizes)
        alpha = self._unwhitened(self._remaining(state), state)
        result = {}
        for i, kernel in enumerate(self.kernels):
            error = np.zeros((len(self.given), 5))
            for g in self.groups:
                if g.kind == kernel.kind and sizes.kernels[i] > 0:
                    at = np.ix_(g.poses, np.array(g.channels))
                    error[at] = sizes.kernels[i] * kernel.matrix[np.ix_(g.poses, g.poses)] @ alpha[at]
            result[kernel.name] = error
        for size, part in zip(sizes.loaded.tolist(), self.loaded, strict=True):
            weights = np.einsum("kcr,kc->r", part.columns, alpha)
            result[part.name] = size * part.columns @ weights
        return result

    def standardised(self, y: Array, J: Array, sizes: Sizes) -> Array:
        """(K, 5) residuals of leaving each number out, over their own predictive deviation; 0 where none was given."""
        state = self._at(self._flat(y), self._flat(J), sizes)
        alpha = self._unwhitened(self._remaining(state), state)
        result = np.zeros_like(alpha)
        for g, (inverse, hidden) in zip(self.groups, self._projections(state), strict=True):
            for c, less in zip(g.channels, hidden, strict=True):
                result[g.poses, c] = alpha[g.poses, c] / np.sqrt(np.maximum(np.diag(inverse) - less, 1e-12))
        return result

    def mean_variance(self, sizes: Sizes) -> float:
        """Of all parts together over the stated noise's, over all numbers that were given."""
        share = {kind: self.given[:, list(c)].sum() / max(self.count, 1) for kind, c in CHANNELS.items()}
        of_kernels = sum(s * share[k.kind] for s, k in zip(sizes.kernels.tolist(), self.kernels, strict=True))
        return float(of_kernels + sizes.loaded.sum())

    def mean_variance_of_noise(self, sizes: Sizes) -> float:
        """Over the stated one, over all numbers that were given."""
        share = [self.given[:, list(c)].sum() / max(self.count, 1) for c in CHANNELS.values()]
        return float(np.dot(share, 1 + sizes.noise))

    def _flat(self, values: Array) -> Array:
        """(N, ...) group after group, channel after channel."""
        return np.concatenate([values[g.poses, c] for g in self.groups for c in g.channels])

    def _at(self, y: Array, J: Array, sizes: Sizes) -> _State:
        active = np.repeat(sizes.loaded > 0, np.bincount(self._of, minlength=len(self.loaded)))
        scale = np.sqrt(sizes.loaded[self._of[active]])
        columns = self._flat(self._columns[:, :, active]) * scale
        whole = np.column_stack([columns, J, y])
        factors: list[Array] = []
        logdet, at = 0.0, 0
        for g, stack in zip(self.groups, self._stack, strict=True):
            V = self._covariance(g, stack, sizes)
            L: Array = np.asarray(np.linalg.cholesky(V), dtype=np.float64)
            n = len(g.poses)
            for _ in g.channels:
                whole[at : at + n] = solve_triangular(L, whole[at : at + n], lower=True, check_finite=False)
                logdet += float(np.log(np.diag(L)).sum())
                at += n
            factors.append(L)
        design, residual = whole[:, :-1], whole[:, -1]
        root = np.linalg.cholesky(np.eye(design.shape[1]) + design.T @ design)
        solved = solve_triangular(root, design.T @ residual, lower=True, check_finite=False)
        evidence = -0.5 * (residual @ residual - solved @ solved) - logdet - float(np.log(np.diag(root)).sum())
        evidence -= 0.5 * self.count * np.log(2 * np.pi) - _log_prior(sizes)
        return _State(float(evidence), factors, design, root, residual, solved)

    def _covariance(self, g: _Group, stack: Array, sizes: Sizes) -> Array:
        which = 0 if g.kind == "position" else 1
        own = (1 + sizes.noise[which]) * np.eye(len(g.poses))
        V: Array = self.shared[which][np.ix_(g.poses, g.poses)] + own
        on = sizes.kernels[self._place[g.kind]]
        there = on > 0
        if there.any():
            V = V + np.tensordot(on[there], stack[there], axes=1)
        return V

    def _remaining(self, state: _State) -> Array:
        """(N,) whitened, V^-1 y times the factor."""
        inner = solve_triangular(state.root, state.solved, lower=True, trans="T", check_finite=False)
        return np.asarray(state.residual - state.columns @ inner)

    def _unwhitened(self, values: Array, state: _State) -> Array:
        """(K, 5) V^-1 y."""
        result, at = np.zeros((len(self.given), 5)), 0
        for g, L in zip(self.groups, state.factors, strict=True):
            for c in g.channels:
                n = len(g.poses)
                result[g.poses, c] = solve_triangular(L, values[at : at + n], lower=True, trans="T", check_finite=False)
                at += n
        return result

    def _projections(self, state: _State) -> list[tuple[Array, list[Array]]]:
        """Of each group the inverse of its covariance, and per channel the diagonal that columns take from it."""
        hidden = solve_triangular(state.root, state.columns.T, lower=True, check_finite=False).T
        results, at = [], 0
        for g, L in zip(self.groups, state.factors, strict=True):
            inverse = cho_solve((L, True), np.eye(len(L)), check_finite=False)
            taken = []
            for _ in g.channels:
                n = len(g.poses)
                H = solve_triangular(L, hidden[at : at + n], lower=True, trans="T", check_finite=False)
                taken.append((H**2).sum(axis=1))
                at += n
            results.append((inverse, taken))
        return results

    def _newton(self, state: _State, sizes: Sizes) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Gradient by all sizes, the step, and which sizes are free to move."""
        m, total = len(self.kernels), len(self.kernels) + len(self.loaded) + 2
        left = self._remaining(state)
        hidden = solve_triangular(state.root, state.columns.T, lower=True, check_finite=False).T  # (N, A + P)
        square, trace, worked = np.zeros(total), np.zeros(total), np.zeros((self.count, total))
        loaded = np.zeros((self.count, self._columns.shape[2]))
        at = 0
        for g, stack, L in zip(self.groups, self._stack, state.factors, strict=True):
            n, C = len(g.poses), len(g.channels)
            rows = slice(at, at + n * C)
            inverse = cho_solve((L, True), np.eye(n), check_finite=False)
            R = hidden.shape[1]
            side = hidden[rows].reshape(C, n, R).transpose(1, 0, 2).reshape(n, C * R)
            H = solve_triangular(L, side, lower=True, trans="T", check_finite=False)
            P = C * inverse - H @ H.T
            own = self._columns[g.poses][:, list(g.channels)].reshape(n, -1)
            loaded[rows] = (
                solve_triangular(L, own, lower=True, check_finite=False)
                .reshape(n, C, -1)
                .transpose(1, 0, 2)
                .reshape(n * C, -1)
            )
            a = solve_triangular(L, left[rows].reshape(C, n).T, lower=True, trans="T", check_finite=False)  # (n, C)
            index = self._place[g.kind]
            if len(index):
                Ka = stack @ a  # (m, n, C)
                square[index] += np.einsum("mnc,nc->m", Ka, a)
                trace[index] += stack.reshape(len(index), -1) @ P.ravel()
                flat = Ka.transpose(1, 0, 2).reshape(n, -1)
                back = solve_triangular(L, flat, lower=True, check_finite=False).reshape(n, len(index), C)
                worked[rows.start : rows.stop, index] = back.transpose(2, 0, 1).reshape(C * n, len(index))
            j = total - 2 + (g.kind == "tangent")
            square[j] += (a**2).sum()
            trace[j] += np.trace(P)
            worked[rows, j] = solve_triangular(L, a, lower=True, check_finite=False).T.ravel()
            at += n * C
        weights = loaded.T @ left
        crossed = hidden.T @ loaded
        square[m:-2] = np.bincount(self._of, weights=weights**2, minlength=len(self.loaded))
        spread = (loaded**2).sum(axis=0) - (crossed**2).sum(axis=0)
        trace[m:-2] = np.bincount(self._of, weights=spread, minlength=len(self.loaded))
        each = np.zeros((len(weights), len(self.loaded)))
        each[np.arange(len(weights)), self._of] = weights
        worked[:, m:-2] = loaded @ each
        vector = sizes.vector
        gradient = 0.5 * (square - trace) + _log_prior_slope(sizes)
        free = (vector > 0) | (gradient > 0.02)
        free[-2:] = [any(g.kind == kind for g in self.groups) for kind in CHANNELS]
        step = np.zeros(total)
        if free.any():
            w = worked[:, free]
            w_hidden = hidden.T @ w
            information = 0.5 * (w.T @ w - w_hidden.T @ w_hidden)
            near = np.maximum(np.where(np.arange(total) >= total - 2, 1 + vector, vector), 0.05)[free]
            information += np.diag(0.075 * np.abs(trace[free]) / near + 1e-9)  # a part of what EM's step would be
            step[free] = np.linalg.solve(information, gradient[free])
        return gradient, step, free


def _moved(sizes: Sizes, step: Array, free: NDArray[np.bool_]) -> Sizes:
    vector = sizes.vector
    new = np.where(free, vector + step, 0.0)
    new = np.clip(new, np.where(vector > 4 * NEGLIGIBLE, 0.05 * vector, 0.0), 6 * vector + 0.5)
    new[new < NEGLIGIBLE] = 0.0
    noise = 1 + sizes.noise
    grown = np.where(free[-2:], np.clip(noise + step[-2:], 0.5 * noise, 3 * noise), noise)
    m = len(sizes.kernels)
    return Sizes(new[:m], new[m:-2], np.maximum(grown - 1, LEAST_NOISE))


def _log_prior(sizes: Sizes) -> float:
    """Of the sizes: half-Cauchy on a part's deviation over the noise's; of the noise, log-Cauchy above what is stated.

    Below it is log-normal: poses that lie nearer than their noise are a sign of parts that follow it.
    """
    parts = -np.log1p(np.concatenate([sizes.kernels, sizes.loaded])).sum()
    ratio = np.log1p(sizes.noise) / NOISE_SPREAD
    return float(parts - np.where(ratio > 0, np.log1p(ratio**2), ratio**2).sum())


def _log_prior_slope(sizes: Sizes) -> Array:
    parts = -1 / (1 + np.concatenate([sizes.kernels, sizes.loaded]))
    ratio = np.log1p(sizes.noise) / NOISE_SPREAD
    slope = np.where(ratio > 0, -2 * ratio / (1 + ratio**2), -2 * ratio)
    return np.concatenate([parts, slope / NOISE_SPREAD / (1 + sizes.noise)])


def _groups(given: NDArray[np.bool_]) -> list[_Group]:
    results: list[_Group] = []
    for kind, channels in CHANNELS.items():
        for c in channels:
            if not given[:, c].any():
                continue
            same = [
                k
                for k, g in enumerate(results)
                if g.kind == kind and np.array_equal(given[:, g.channels[0]], given[:, c])
            ]
            if same:
                results[same[0]] = replace(results[same[0]], channels=(*results[same[0]].channels, c))
            else:
                results.append(_Group(kind, np.flatnonzero(given[:, c]), (c,)))
    return results
