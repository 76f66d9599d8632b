"""What no effect explains, as a random error with a size and a memory; it is in the covariance, never a candidate.

Residuals over the noise have the covariance I + s^2 R within a block and none between blocks. On a continuous motion
R = exp(-|t - t'| / memory); of poses at rest a block is a configuration, and R = a for two approaches of it, 1 for one.
Position and tangent have sizes s of their own. Multiplying by (I + s^2 R)^(-1/2) makes residuals white again.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

T = TypeVar("T")
POSITION, TANGENT = slice(0, 3), slice(3, None)  # of the numbers of a pose
SIZES = np.concatenate([[0.0], np.geomspace(0.1, 1000.0, 33)])  # of s, over the noise
SHARES = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0])  # of the variance that approaches of a configuration share
STRIDE = 4  # of sizes that are asked first
MEMORIES = 12  # tried, from half a step to a quarter of the motion


@dataclass(frozen=True, eq=False)
class Block:
    """Poses whose discrepancies go together, with the eigenvalues and eigenvectors of their correlation R."""

    poses: NDArray[np.int_]
    values: Array
    vectors: Array


Chosen = int | slice | NDArray[np.int_]  # numbers of sizes
Pairs = list[tuple[int, int]]  # numbers of a size of position and one of tangent
Highest = tuple[float, float, float]  # an evidence, and the sizes of position and tangent that it has
Numbered = tuple[NDArray[np.int_], Block]  # (k, c) of the numbers r.ravel() of a fit, c for each row of a block


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Sizes over the noise of a coordinate of the position and of the tangent, and what goes together."""

    position: float
    tangent: float
    memory: float  # s of a continuous motion; of poses at rest the share a that belongs to the configuration
    blocks: tuple[Block, ...]

    @property
    def is_there(self) -> bool:
        """Whether there is more than noise."""
        return max(self.position, self.tangent) > 0

    def whitened(self, values: Array) -> Array:
        """(K, 5, ...) residuals or derivatives over the noise, multiplied by (I + s^2 R)^(-1/2)."""
        return _times(self._whitening, values)

    def coloured(self, values: Array) -> Array:
        """The inverse of `whitened`."""
        return _times(self._colouring, values)

    @cached_property
    def _whitening(self) -> Factors:
        return self._factors(-0.5)

    @cached_property
    def _colouring(self) -> Factors:
        return self._factors(0.5)

    def _factors(self, power: float) -> Factors:
        """Powers of the covariance of the numbers that go together."""
        return [
            (block.poses, part, (block.vectors * (1 + size**2 * block.values) ** power) @ block.vectors.T)
            for part, size in ((POSITION, self.position), (TANGENT, self.tangent))
            if size
            for block in self.blocks
        ]


Factors = list[tuple[NDArray[np.int_], slice, Array]]  # poses, numbers of each, and a matrix (k, k) of the poses


def _times(factors: Factors, values: Array) -> Array:
    """(K, 5, ...) numbers multiplied by factors, those of other poses as they are."""
    new = np.array(values, dtype=np.float64)
    for poses, part, factor in factors:
        some = values[poses, part]
        new[poses, part] = (factor @ some.reshape(len(poses), -1)).reshape(some.shape)
    return new


@dataclass(frozen=True, eq=False)
class Linearised:
    """What an estimate reads: residuals r (K, 5) at the priors' centres, derivatives J (K, 5, P), precision (P,)."""

    r: Array
    J: Array
    precision: Array


def of_motion(fit: Linearised, time_s: Array, run: NDArray[np.int_], longest_s: float) -> Discrepancy:
    """The most probable discrepancy of a continuous motion with poses at times (K,) of runs (K,)."""
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    memories = np.geomspace(max(step / 2, 1e-6), max(longest_s / 4, step), MEMORIES)
    rows = [np.flatnonzero(run == number) for number in np.unique(run)]
    return _most_probable(fit, rows, memories, lambda poses, memory: decay(time_s[poses], memory))


def of_configurations(fit: Linearised, configuration: NDArray[np.int_]) -> Discrepancy:
    """The most probable discrepancy of poses at rest, (K,) numbers of their configurations."""
    rows = [np.flatnonzero(configuration == number) for number in np.unique(configuration)]
    return _most_probable(fit, rows, SHARES, lambda poses, share: shared(len(poses), share))


def decay(time_s: Array, memory_s: float) -> Array:
    """(K, K) correlation of a discrepancy that is forgotten exponentially."""
    correlation: Array = np.exp(-np.abs(time_s[:, None] - time_s[None]) / memory_s)
    return correlation


def shared(count: int, share: float) -> Array:
    """(K, K) correlation of approaches of one configuration."""
    return share + (1 - share) * np.eye(count)


def within(
    discrepancy: Discrepancy, blocks: Sequence[NDArray[np.int_]], correlation: Callable[..., Array]
) -> Discrepancy:
    """This discrepancy for other poses, given by their blocks; correlation(poses, memory) is that of a block."""
    return replace(
        discrepancy, blocks=tuple(block_of(poses, correlation(poses, discrepancy.memory)) for poses in blocks)
    )


def block_of(poses: NDArray[np.int_], correlation: Array) -> Block:
    """A block of poses with their correlation (k, k)."""
    values, vectors = np.linalg.eigh(correlation)
    return Block(poses, np.maximum(values, 0.0), vectors)


def _most_probable(
    fit: Linearised,
    rows: Sequence[NDArray[np.int_]],
    memories: Array,
    correlation: Callable[[NDArray[np.int_], float], Array],
) -> Discrepancy:
    """The best of all memories and sizes, by the likelihood with the parameters integrated out over their priors.

    An error that is not there has no memory, and the first stands for all: rounding would choose among them.
    """
    best, highest = None, -np.inf
    for memory in memories.tolist():
        blocks = tuple(block_of(poses, correlation(poses, memory)) for poses in rows)
        value, position, tangent = Spectrum.at(fit, blocks).highest()
        if best is None or (value > highest and max(position, tangent) > 0):
            best, highest = Discrepancy(position, tangent, memory, blocks), value
    assert best is not None
    return best


@dataclass(frozen=True, eq=False)
class SizeSums:
    """Sums over one part of the poses' numbers at S sizes of the discrepancy: normal systems and likelihoods."""

    size: Array  # (S,)
    along: Array  # (N, P) derivatives along the eigenvectors whose weights the sizes change apart
    weight: Array  # (S, N) these weights
    same: Array  # (M, P) along all others
    of_all: Array  # (S,) their weight
    alike: NDArray[np.bool_]  # (N + M,) which these are
    g: Array  # (S, P)
    likelihood: Array  # (S,) twice the log-likelihood at the priors' centres, up to a constant
    _normal: Array  # (S, P, P) normal matrices of the sizes that were asked for
    _is_known: NDArray[np.bool_]  # (S,) which these are

    @classmethod
    def over(cls, fit: Linearised, blocks: Sequence[Numbered], sizes: Array) -> SizeSums:
        """The sums of the numbers of some blocks; without blocks there is one size, 0, and no sum."""
        if not blocks:
            sizes = np.zeros(1)
        J = _along(fit.J.reshape(fit.r.size, -1), blocks)
        values = np.concatenate([np.zeros(0), *(np.repeat(b.values, numbers.shape[1]) for numbers, b in blocks)])
        usual = np.median(values) if len(values) else 0.0
        alike = np.isclose(values, usual, rtol=0, atol=1e-9)  # approaches of one configuration, among them
        weight, of_all = 1 / (1 + sizes[:, None] ** 2 * values[~alike]), 1 / (1 + sizes**2 * usual)
        none = np.zeros((len(sizes), J.shape[1])), np.zeros(len(sizes))
        normal = np.empty((len(sizes), *2 * J.shape[1:])), np.zeros(len(sizes), dtype=bool)
        return cls(sizes, J[~alike], weight, J[alike], of_all, alike, *none, *normal).of_residuals(fit.r, blocks)

    def of_residuals(self, r: Array, blocks: Sequence[Numbered]) -> SizeSums:
        """The sums with other residuals (K, 5) of the same numbers."""
        along_r = _along(r.reshape(-1, 1), blocks)[:, 0]
        y, of_same, of_all = along_r[~self.alike], along_r[self.alike], self.of_all
        volume = np.log(self.weight).sum(axis=1) + len(of_same) * np.log(of_all)
        return replace(
            self,
            g=(self.weight * y) @ self.along + of_all[:, None] * (of_same @ self.same),
            likelihood=volume - self.weight @ y**2 - of_all * (of_same @ of_same),
        )

    def H(self, numbers: NDArray[np.int_], columns: NDArray[np.int_] | slice) -> Array:
        """(K, P, P) the normal matrices of some parameters at numbers (K,) of the sizes."""
        if len(new := numbers[~self._is_known[numbers]]):
            new = np.unique(new)
            weighted = np.sqrt(self.weight[new])[:, :, None] * self.along
            self._normal[new] = weighted.transpose(0, 2, 1) @ weighted + self.of_all[new, None, None] * self._of_same
            self._is_known[new] = True
        if isinstance(columns, slice):
            return self._normal[numbers]
        return self._normal[numbers[:, None, None], columns[:, None], columns]

    @cached_property
    def _of_same(self) -> Array:
        """(P, P) the normal matrix of what all sizes weigh alike."""
        squares: Array = self.same.T @ self.same
        return squares


def _along(values: Array, blocks: Sequence[Numbered]) -> Array:
    """(N, ...) the numbers (5 K, ...) of some blocks along their eigenvectors."""
    count = values.shape[1]
    parts = (np.tensordot(b.vectors.T, values[numbers], axes=1).reshape(-1, count) for numbers, b in blocks)
    return np.concatenate([np.zeros((0, count)), *parts])


System = tuple[Array, Array, Array]  # normal matrices (K, P, P), right sides (K, P), twice the log-likelihoods (K,)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A fit in the eigenvectors of the discrepancy's blocks, where its covariance is diagonal: sums at every size."""

    precision: Array  # (P,) of the parameters' priors
    position: SizeSums
    tangent: SizeSums
    columns: NDArray[np.int_]  # (P + M,) where the parameters are in the sums, and others that are moved
    moved: Array = field(default_factory=lambda: np.zeros(0))  # (M,) by how much
    begin: tuple[int, int] | None = None  # numbers of sizes near which the highest evidence is sought
    modes: int = 0  # last parameters of the sums, of unit priors: the amounts of a process, over which is integrated
    _marginalised: dict[tuple[int, int], System] = field(default_factory=dict)  # over the process, by numbers of sizes

    @classmethod
    def at(cls, fit: Linearised, blocks: Sequence[Block]) -> Spectrum:
        """The linearised fit whose discrepancy has these blocks, of every number of a pose alike."""
        numbers = np.arange(fit.r.size).reshape(fit.r.shape)
        position, tangent = ([(numbers[b.poses, part], b) for b in blocks] for part in (POSITION, TANGENT))
        return cls.apart(fit, position, tangent)

    @classmethod
    def apart(
        cls,
        fit: Linearised,
        position: Sequence[Numbered],
        tangent: Sequence[Numbered],
        sizes: tuple[Array, Array] = (SIZES, SIZES),
        modes: int = 0,
    ) -> Spectrum:
        """The linearised fit whose positions and tangents have blocks of their own; sizes: those required, of each.

        modes: how many of the last parameters are the amounts of a process.
        """
        sums = SizeSums.over(fit, position, sizes[0]), SizeSums.over(fit, tangent, sizes[1])
        own = len(fit.precision) - modes
        return cls(fit.precision[:own], *sums, np.arange(own), modes=modes)

    def of(self, columns: Sequence[int], precision: Array | None = None, moved: Array | None = None) -> Spectrum:
        """The linearised fit in some of the parameters, with other priors.

        The others stay where they do nothing, or are moved from there by (P,), which is zero for those of the fit.
        """
        kept = np.array(columns, dtype=np.int_)
        priors = self.precision[kept] if precision is None else precision
        some = np.flatnonzero(moved) if moved is not None else kept[:0]
        amount = moved[some] if moved is not None else self.moved
        return replace(self, precision=priors, columns=self.columns[[*kept, *some]], moved=amount)

    def of_residuals(self, r: Array, position: Sequence[Numbered], tangent: Sequence[Numbered]) -> Spectrum:
        """The spectrum of a fit with other residuals (K, 5), whose numbers have the same blocks."""
        sums = self.position.of_residuals(r, position), self.tangent.of_residuals(r, tangent)
        begin, known = self.begin, self._evidences
        if not np.isnan(known).all():
            begin = divmod(int(np.nanargmax(known)), known.shape[1])
        return replace(self, position=sums[0], tangent=sums[1], begin=begin, _marginalised={})

    @cached_property
    def _evidences(self) -> Array:
        """(S, T) those that are known, NaN elsewhere: a pair of sizes is worked out once."""
        return np.full((len(self.position.size), len(self.tangent.size)), np.nan)

    def highest(self) -> Highest:
        """The highest evidence, and the sizes of position and tangent that it has."""
        return highest_of([self])[0]

    def climb(self) -> Generator[Pairs, None, Highest]:
        """Seeks the highest evidence along one size after the other until both stay; yields the pairs it asks for.

        Every fourth size is asked, and then the neighbours of the best at half that distance, and half again; these
        alone where it is known near which sizes it is.
        """
        at, stride = ([0, 0], STRIDE) if self.begin is None else (list(self.begin), STRIDE // 2)
        while stride:
            before = list(at)
            for k, count in enumerate(self._evidences.shape):
                low, high = (0, count) if stride == STRIDE else (at[k] - stride, min(at[k] + stride + 1, count))
                near = range(low if low >= 0 else at[k], high, stride)
                pairs = [(number, at[1]) if k == 0 else (at[0], number) for number in near]
                yield pairs
                at[k] = near[int(np.argmax([self._evidences[pair] for pair in pairs]))]
            stride //= 1 + (at == before)
        return float(self._evidences[tuple(at)]), float(self.position.size[at[0]]), float(self.tangent.size[at[1]])

    def log_mean(self, peak: Highest) -> Generator[Pairs, None, float]:
        """Twice the logarithm of the mean evidence over sizes, by the lines through its peak; yields pairs to ask for.

        A line counts as far as rounding leaves anything beside the peak: evidences fall on either side of it.
        """
        result, least = peak[0], peak[0] + 2 * float(np.log(np.finfo(float).eps))
        p, t = (int(np.abs(s.size - at).argmin()) for s, at in ((self.position, peak[1]), (self.tangent, peak[2])))
        yield [(p, t)]
        for at, line, is_position in ((p, self._evidences[:, t], True), (t, self._evidences[p], False)):
            low, high, count = at, at + 1, len(line)
            while True:
                down = range(max(low - STRIDE, 0), low) if line[low] > least else range(0)
                up = range(high, min(high + STRIDE, count)) if line[high - 1] > least else range(0)
                if not (down or up):
                    break
                yield [(number, t) if is_position else (p, number) for number in (*down, *up)]
                low, high = low - len(down), high + len(up)
            result += 2 * float(np.log(np.exp((line[low:high] - peak[0]) / 2).sum() / count))
        return result

    @property
    def without_error(self) -> float:
        """Twice the logarithm of the evidence beside noise alone, up to a constant."""
        return float(self.evidences(0, 0))

    def evidences(self, position: Chosen, tangent: Chosen) -> Array:
        """(S,) twice their logarithms, up to a constant, at numbers of the sizes; one of each is a single number."""
        rows, columns = map(np.arange, self._evidences.shape)
        p, t = np.broadcast_arrays(rows[position], columns[tangent])
        _work_out([(self, list(zip(p.ravel().tolist(), t.ravel().tolist(), strict=True)))])
        return np.array(self._evidences[p, t])

    def normal_system(self, p: NDArray[np.int_], t: NDArray[np.int_]) -> System:
        """The system at numbers (K,) of the sizes, over the priors' widths, without what is moved or integrated."""
        H, g, likelihood = self._beside_process(p, t) if self.modes else self._sums(p, t, self._chosen)
        if count := len(self.moved):  # residuals r become r + J moved
            of_moved = H[..., -count:] @ self.moved
            likelihood = likelihood - (2 * g + of_moved)[..., -count:] @ self.moved
            H, g = H[..., :-count, :-count], (g + of_moved)[..., :-count]
        scale = 1 / np.sqrt(self.precision)
        return H * scale[:, None] * scale, g * scale, likelihood

    @cached_property
    def _chosen(self) -> NDArray[np.int_] | slice:
        """The columns, as a slice where they are all."""
        every = np.arange(self.position.g.shape[1])
        return slice(None) if np.array_equal(self.columns, every) else self.columns

    def _sums(self, p: NDArray[np.int_], t: NDArray[np.int_], columns: NDArray[np.int_] | slice) -> System:
        """Normal systems of some parameters, and twice the log-likelihoods, at numbers (K,) of the sizes."""
        first, second = self.position, self.tangent
        return (
            first.H(p, columns) + second.H(t, columns),
            first.g[p][:, columns] + second.g[t][:, columns],
            first.likelihood[p] + second.likelihood[t],
        )

    def _beside_process(self, p: NDArray[np.int_], t: NDArray[np.int_]) -> System:
        """Systems and log-likelihoods as of `_sums`, beside the process, over whose amounts is integrated.

        What it explains is taken out of the system of all other parameters once at a pair of sizes, whichever of those
        are wanted.
        """
        from scipy.linalg import solve_triangular  # slow to import

        pairs, m, kept = list(zip(p.tolist(), t.tolist(), strict=True)), self.modes, self.columns
        for k, pair in enumerate(pairs):
            if pair not in self._marginalised:
                H, g, likelihood = (values[0] for values in self._sums(p[k : k + 1], t[k : k + 1], slice(None)))
                factor = np.linalg.cholesky(H[-m:, -m:] + np.eye(m))
                seen = solve_triangular(factor, np.column_stack([H[-m:, :-m], g[-m:]]), lower=True, check_finite=False)
                taken = seen.T @ seen
                likelihood = likelihood + taken[-1, -1] - 2 * np.log(np.diag(factor)).sum()
                self._marginalised[pair] = H[:-m, :-m] - taken[:-1, :-1], g[:-m] - taken[:-1, -1], likelihood
        systems = [self._marginalised[pair] for pair in pairs]
        H = np.array([H[kept[:, None], kept] for H, _, _ in systems])
        return H, np.array([g[kept] for _, g, _ in systems]), np.array([likelihood for *_, likelihood in systems])


def highest_of(spectra: Sequence[Spectrum]) -> list[Highest]:
    """The highest evidence of each, and its sizes."""
    return _together(spectra, [spectrum.climb() for spectrum in spectra])


def log_means(spectra: Sequence[Spectrum], peaks: Sequence[Highest]) -> list[float]:
    """Twice the logarithms of the mean evidence of each over sizes, by the lines through its peak."""
    return _together(spectra, [spectrum.log_mean(peak) for spectrum, peak in zip(spectra, peaks, strict=True)])


def _together(spectra: Sequence[Spectrum], searches: Sequence[Generator[Pairs, None, T]]) -> list[T]:
    """The results of searches, one of each spectrum; what all of them ask for next is worked out at once."""
    running, results = dict(enumerate(searches)), dict[int, T]()
    while running:
        wanted = list[tuple[Spectrum, Pairs]]()
        for k, search in list(running.items()):
            try:
                wanted.append((spectra[k], next(search)))
            except StopIteration as end:
                results[k] = end.value
                del running[k]
        _work_out(wanted)
    return [results[k] for k in range(len(searches))]


def _work_out(wanted: Sequence[tuple[Spectrum, Pairs]]) -> None:
    """The evidences at pairs of sizes that are not known yet; those of as many parameters at once."""
    of_count = dict[int, list[tuple[Spectrum, NDArray[np.int_], NDArray[np.int_]]]]()
    for spectrum, pairs in wanted:
        if new := [pair for pair in pairs if np.isnan(spectrum._evidences[pair])]:
            p, t = np.array(new).T
            of_count.setdefault(len(spectrum.precision), []).append((spectrum, p, t))
    for alike in of_count.values():
        systems = [spectrum.normal_system(p, t) for spectrum, p, t in alike]
        H, g, likelihood = (np.concatenate(parts) for parts in zip(*systems, strict=True))
        values = np.split(likelihood + integral(H, g), np.cumsum([len(p) for _, p, _ in alike])[:-1])
        for (spectrum, p, t), own in zip(alike, values, strict=True):
            spectrum._evidences[p, t] = own


def integral(H: Array, g: Array, least: Array | float = 1.0) -> Array:
    """(...) what parameters of unit priors with normal systems (..., P, P), (..., P) add to twice the logarithm.

    With g below H in one matrix, the last row of its factor squares to g^T (H + 1)^-1 g. The corner is larger than
    that, for H with the priors is no smaller than 1, or than what `least` (...) rounding leaves it.
    """
    count = g.shape[-1]
    whole = np.empty((*g.shape[:-1], count + 1, count + 1))
    whole[..., :-1, :-1] = H
    diagonal = np.einsum("...ii->...i", whole)  # a view
    diagonal[..., :-1] += np.asarray(least)[..., None]
    whole[..., -1, :-1] = g
    diagonal[..., -1] = 2 * (1.0 + (g**2).sum(axis=-1))
    factor = np.linalg.cholesky(whole)
    pivots = np.diagonal(factor, axis1=-2, axis2=-1)[..., :-1]
    added: Array = (factor[..., -1, :-1] ** 2).sum(axis=-1) - 2 * np.log(pivots).sum(axis=-1)
    return added
